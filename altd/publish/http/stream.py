"""The stream: server-sent events (WHATWG HTML, 9.2), one for each measurement that a client keeps up with."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Sequence

from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from altd.publish.http.errors import refusal
from altd.publish.http.resuming import Resume, id_of, key_of
from altd.records import Measurement
from altd.status.board import Board
from altd.status.health import Component
from altd.status.measurement_json import checked_line
from altd.status.proof import Stamps

MAX_STREAMS = 16
"""Streams that are served at a time."""

KEEP_ALIVE_INTERVAL_S = 1.0
"""After this much silence a comment says that the unit is still there."""

RETRY_MS = 2000
"""When a browser that lost the stream comes back."""


def event(measurement: Measurement, line: str) -> str:
    """One measurement, and its line of JSON, as an event whose id is its sequence."""
    return f"id: {measurement.sequence}\ndata: {line}\n\n"


async def events(
    board: Board, component: Component, stamps: Stamps, resuming: Resuming | None = None
) -> AsyncGenerator[str, None]:
    """The latest measurement and every later one that is still the latest when the client takes it.

    A measurement that goes stale is an event, too, an invalid one. ``resuming``: how a stream that
    can be resumed continues, what was missed among it.
    """
    cursor = board.cursor()
    told: Measurement | None = None
    yield f"retry: {RETRY_MS}\n\n"
    try:
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
                line = checked_line(board, latest, stamps.next())
                yield event(latest, line) if resuming is None else resuming.event(latest, line)
            for each in () if resuming is None or told is None else resuming.past(told):
                yield each
    finally:
        if resuming is not None:
            resuming.end()


class Resuming:
    """A stream whose events have ids by which it is resumed; ``missed``: what the client asks to have."""

    def __init__(self, missed: Resume | None) -> None:
        self._missed = missed
        self._until: Measurement | None = None
        self._asking: asyncio.Task[Sequence[str]] | None = None

    def event(self, measurement: Measurement, line: str) -> str:
        """A current measurement; without an id while something of before is missing."""
        if self._missed is not None:
            return f"data: {line}\n\n"
        return f"id: {id_of(key_of(measurement))}\ndata: {line}\n\n"

    def past(self, told: Measurement) -> Sequence[str]:
        """The events missed before the first measurement sent, once they have arrived; never waits."""
        if self._missed is None:
            return ()
        self._until = self._until or told
        if self._asking is None:
            self._asking = asyncio.create_task(self._missed.events(self._until))
        if not self._asking.done():
            return ()
        events, self._asking = self._asking.result(), None
        if self._missed.is_done:
            self._missed = None
        return events

    def end(self) -> None:
        """The client has left."""
        if self._asking is not None:
            self._asking.cancel()


class Streams:
    """The number of open streams, to limit them."""

    def __init__(self, board: Board, component: Component, stamps: Stamps) -> None:
        self.board = board
        self.component = component
        self.stamps = stamps
        self.open = 0


class EventStream(StreamingResponse):
    """The answer to one client, for as long as it stays; a refusal when there are enough."""

    media_type = "text/event-stream"

    def __init__(self, streams: Streams, resuming: Resuming | None = None) -> None:
        self._streams = streams
        self._events = events(streams.board, streams.component, streams.stamps, resuming)
        super().__init__(self._events)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve the client until it goes away."""
        streams = self._streams
        if streams.open >= MAX_STREAMS:
            streams.component.count("streams_refused")
            await refusal(503, f"{MAX_STREAMS} streams are open already")(scope, receive, send)
            return
        streams.open += 1
        streams.component.count("streams")
        try:
            async with contextlib.aclosing(self._events):
                await super().__call__(scope, receive, send)
        finally:
            streams.open -= 1
