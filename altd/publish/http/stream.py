"""The stream: server-sent events (WHATWG HTML, 9.2), one for each measurement that a client keeps up with."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator

from starlette.responses import JSONResponse, StreamingResponse
from starlette.types import Receive, Scope, Send

from altd.records import Measurement
from altd.status.board import Board
from altd.status.health import Component
from altd.status.measurement_json import as_line

MAX_STREAMS = 16
"""Streams that are served at a time."""

KEEP_ALIVE_INTERVAL_S = 1.0
"""After this much silence a comment says that the unit is still there."""

RETRY_MS = 2000
"""When a browser that lost the stream comes back."""


def event(measurement: Measurement) -> str:
    """One measurement as an event whose id is its sequence."""
    return f"id: {measurement.sequence}\ndata: {as_line(measurement)}\n\n"


async def events(board: Board, component: Component) -> AsyncGenerator[str, None]:
    """The latest measurement and every later one that is still the latest when the client takes it.

    A measurement that goes stale is told too: as an event that is invalid.
    """
    cursor = board.cursor()
    told: Measurement | None = None
    yield f"retry: {RETRY_MS}\n\n"
    while True:
        skipped = cursor.skipped
        try:
            async with asyncio.timeout(KEEP_ALIVE_INTERVAL_S):
                latest: Measurement | None = await cursor.next()
        except TimeoutError:
            latest = board.read()
        component.count("events_skipped", cursor.skipped - skipped)
        if latest is None or latest == told:
            yield ": nothing new\n\n"
        else:
            told = latest
            component.gave_data()
            yield event(latest)


class Streams:
    """How many streams are open, so that they stay few."""

    def __init__(self, board: Board, component: Component) -> None:
        self.board = board
        self.component = component
        self.open = 0


class EventStream(StreamingResponse):
    """The answer to one client, for as long as it stays; a refusal when there are enough."""

    media_type = "text/event-stream"

    def __init__(self, streams: Streams) -> None:
        self._streams = streams
        self._events = events(streams.board, streams.component)
        super().__init__(self._events)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve the client until it goes away."""
        streams = self._streams
        if streams.open >= MAX_STREAMS:
            streams.component.count("streams_refused")
            refusal = JSONResponse({"error": f"{MAX_STREAMS} streams are open already"}, status_code=503)
            await refusal(scope, receive, send)
            return
        streams.open += 1
        streams.component.count("streams")
        try:
            async with contextlib.aclosing(self._events):
                await super().__call__(scope, receive, send)
        finally:
            streams.open -= 1
