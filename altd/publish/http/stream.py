"""Stream of server-sent events (WHATWG HTML, 9.2), one per measurement; slow clients skip some."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
from collections.abc import AsyncGenerator, Mapping, Sequence
from datetime import UTC, datetime
from typing import ClassVar

from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from altd.history.history import History, NoHistoryError
from altd.history.reader import Reader
from altd.history.records import StoredMeasurement
from altd.ports import Clock
from altd.publish.http.errors import refusal
from altd.records import Measurement, Quantities, utc_text
from altd.status.board import Board
from altd.status.health import Component
from altd.status.measurement_json import checked_line, targets_object
from altd.status.proof import Stamps

MAX_STREAMS = 16
"""Maximum number of streams that are served at a time."""

KEEP_ALIVE_INTERVAL_S = 1.0
"""Time without an event until a comment is sent, which shows that the unit is alive."""

RETRY_MS = 2000
"""Time until a browser reconnects after it has lost the stream."""


def event(measurement: Measurement, line: str) -> str:
    """Return a measurement's line of JSON as an event whose id is its sequence."""
    return f"id: {measurement.sequence}\ndata: {line}\n\n"


async def events(
    board: Board, component: Component, stamps: Stamps, resuming: Resuming | None = None
) -> AsyncGenerator[str, None]:
    """Yield the latest measurement, and every later one that is still the latest when the client is ready.

    A measurement that becomes stale is also an event, an invalid one. ``resuming`` makes the events of a
    resumable stream, including missed ones.
    """
    cursor = board.cursor()
    sent: Measurement | None = None
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
            if latest is None or latest == sent:
                yield ": nothing new\n\n"
            else:
                sent = latest
                component.gave_data()
                line = checked_line(board, latest, stamps.next())
                yield event(latest, line) if resuming is None else resuming.event(latest, line)
            for each in () if resuming is None or sent is None else resuming.past(sent):
                yield each
    finally:
        if resuming is not None:
            resuming.end()


class Resuming:
    """A stream whose events have ids for resuming; ``missed`` reads measurements that the client missed."""

    def __init__(self, missed: Resume | None) -> None:
        self._missed = missed
        self._until: Measurement | None = None
        self._asking: asyncio.Task[Sequence[str]] | None = None

    def event(self, measurement: Measurement, line: str) -> str:
        """Return the event of a current measurement, without an id while earlier ones are missing."""
        if self._missed is not None:
            return f"data: {line}\n\n"
        return f"id: {id_of(key_of(measurement))}\ndata: {line}\n\n"

    def past(self, sent: Measurement) -> Sequence[str]:
        """Return the events missed before the first measurement sent, once they are ready; never waits."""
        if self._missed is None:
            return ()
        self._until = self._until or sent
        if self._asking is None:
            self._asking = asyncio.create_task(self._missed.events(self._until))
        if not self._asking.done():
            return ()
        events, self._asking = self._asking.result(), None
        if self._missed.is_done:
            self._missed = None
        return events

    def end(self) -> None:
        """Stop reading the missed events: the client has disconnected."""
        if self._asking is not None:
            self._asking.cancel()


class Streams:
    """Sources of the streams, and the number of open ones, to limit them."""

    def __init__(self, board: Board, component: Component, stamps: Stamps) -> None:
        self.board = board
        self.component = component
        self.stamps = stamps
        self.open = 0


class EventStream(StreamingResponse):
    """Response to one client while it is connected; a refusal if too many streams are open."""

    media_type = "text/event-stream"
    own_headers: ClassVar = {"X-Accel-Buffering": "no"}
    """nginx would hold events back until its buffer is full."""

    def __init__(self, streams: Streams, resuming: Resuming | None = None) -> None:
        self._streams = streams
        self._events = events(streams.board, streams.component, streams.stamps, resuming)
        super().__init__(self._events, headers=self.own_headers)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve the client until it disconnects."""
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


MAX_ROWS_AT_ONCE = 100
MAX_ROWS = 12_000
"""Maximum number of missed events: ten minutes at 20/s; ``/api/v1/trend`` covers longer times."""

MAX_WAIT_S = 5.0
"""Maximum wait for the history, which has a measurement within a few seconds."""

_CHECK_INTERVAL_S = 0.5
_ID = re.compile(r"([0-9]{1,18})-([0-9]{1,18})")

Key = tuple[int, int]


def key_of(measurement: Measurement | StoredMeasurement) -> Key:
    """Return the identity of a measurement: its sequence, and its time on the monotonic clock."""
    return measurement.sequence, measurement.t_ns


def id_of(key: Key) -> str:
    """Return the id of an event."""
    return f"{key[0]}-{key[1]}"


class Resume:
    """Measurements that a client missed after the event with ``last_id``, its ``Last-Event-ID``.

    They never delay the newest measurement. They are sent in between, as events of the type ``past``, which
    clients do not mistake for current ones, and as ``gap`` if some are missing. Until all are sent, only past
    events have an id: a client that disconnects again continues there.
    """

    def __init__(self, last_id: str, history: History, quantities: Quantities, clock: Clock) -> None:
        self._history = history
        self._quantities = quantities
        self._clock = clock
        self._last_id = last_id[:64]
        found = _ID.fullmatch(last_id)
        self._after: Key | None = (int(found[1]), int(found[2])) if found else None
        self._row: int | None = None
        self._sent = 0
        self._checked_ns: int | None = None
        self._waits_since_ns: int | None = None
        self.is_done = False

    async def events(self, until: Measurement) -> Sequence[str]:
        """Return the next events before ``until``, which the client has; empty: none yet, or all are sent."""
        now_ns = self._clock.monotonic_ns()
        if self._after is None:
            return self._gap("it is not an id of this stream")
        if self._after == key_of(until):
            self.is_done = True
            return ()
        if self._checked_ns is not None and now_ns - self._checked_ns < _CHECK_INTERVAL_S * 1e9:
            return ()
        try:
            rows = await self._history.ask(self._read)
        except NoHistoryError as error:
            return self._gap(str(error))
        if rows is None:  # the newest rows are not written yet
            return self._waited(now_ns, "the history does not have it", is_short=True, came=False)
        events: list[str] = []
        for key, line in rows:
            if key == key_of(until):
                self.is_done = True
                return events
            events.append(f"id: {id_of(key)}\nevent: past\ndata: {line}\n\n")
            self._sent += 1
        if self._sent >= MAX_ROWS:
            return [*events, *self._gap("too many were missed; see /api/v1/trend")]
        why, is_short = "the history does not have the newest measurements", len(rows) < MAX_ROWS_AT_ONCE
        return [*events, *self._waited(now_ns, why, is_short=is_short, came=bool(rows))]

    def _waited(self, now_ns: int, why: str, *, is_short: bool, came: bool) -> Sequence[str]:
        """Return nothing, to read again soon, or a gap if no row has arrived for ``MAX_WAIT_S``."""
        self._checked_ns = now_ns if is_short else None
        if came or self._waits_since_ns is None:
            self._waits_since_ns = now_ns
        if now_ns - self._waits_since_ns > MAX_WAIT_S * 1e9:
            return self._gap(why)
        return ()

    def _gap(self, why: str) -> Sequence[str]:
        self.is_done = True
        return (f"event: gap\ndata: {json.dumps({'after': self._last_id, 'why': why})}\n\n",)

    def _read(self, reader: Reader) -> list[tuple[Key, str]] | None:
        """Return the next rows as lines of JSON, in the history's thread; None: it lacks the last event."""
        if self._row is None:
            assert self._after is not None  # noqa: S101  checked before
            self._row = reader.id_of(*self._after)
            if self._row is None:
                return None
        rows = reader.measurements_after(self._row, MAX_ROWS_AT_ONCE)
        if rows:
            self._row = rows[-1].id
        names = [key.partition(".")[0] for key in reader.recorded if "." in key]
        targets = tuple(dict.fromkeys(names))
        return [
            (key_of(row), json.dumps(_object(row, self._quantities, targets), allow_nan=False))
            for row in rows
        ]


def time_of(t_us: int) -> str | None:
    """Return a time of the history, µs since 1970, as in the JSON; None: outside the calendar."""
    try:
        return utc_text(datetime.fromtimestamp(t_us * 1e-6, UTC))
    except (ValueError, OverflowError, OSError):
        return None


def _object(row: StoredMeasurement, quantities: Quantities, targets: Sequence[str]) -> Mapping[str, object]:
    """Return a past measurement with the keys that remain true for past measurements."""
    return {
        "sequence": row.sequence,
        "time": time_of(row.t_us),
        "t_s": round(row.t_ns * 1e-9, 6),
        "frames": row.frames,
        "valid": row.valid,
        "status": list(row.status),
        **{each.key: row.values.get(each.key) for each in quantities.of_unit},
        "sigma": {each.key: row.sigmas.get(each.key) for each in quantities.of_unit if each.has_sigma},
        "sigma_random": {
            each.key: row.randoms.get(each.key) for each in quantities.of_unit if each.has_sigma
        },
        **targets_object(quantities, targets, row.known, row.status),
    }
