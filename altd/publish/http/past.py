"""Past values: trend points and events from the unit's history, in limited amounts.

The history's own thread reads them, and writes and compresses the JSON: a month takes about 100 ms without
delaying others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from datetime import datetime
from json import dumps

from starlette.requests import Request
from starlette.responses import Response

from altd.history.history import History
from altd.history.reader import Reader
from altd.history.records import StoredEvent, Trend
from altd.ports import Clock
from altd.publish.http import models
from altd.publish.http.compression import compressed
from altd.publish.http.errors import Refused, refusal
from altd.publish.http.stream import Resume, time_of
from altd.records import Quantities
from altd.status.answer import Answer
from altd.status.event_log import EventKind

MAX_POINTS = 1000
POINTS = 500
MAX_EVENTS = 500
EVENTS = 100
SPAN_S = 3600.0
"""Time before now at which a trend starts by default."""

LAST_S = 253_402_300_799
"""End of the year 9999, UTC, seconds since 1970."""

_US = 10**6


class Past:
    """Answers requests for the history of one unit."""

    def __init__(self, history: History, quantities: Quantities, clock: Clock) -> None:
        self.history = history
        self._quantities = quantities
        self._clock = clock

    async def trend(self, request: Request) -> Response:
        """Return each quantity over time, in columns: a number or null for each point."""
        return await self._answer(request, self._trend_query)

    async def events(self, request: Request) -> Response:
        """Return the events, the newest first."""
        return await self._answer(request, self._events_query)

    def since(self, last_id: str) -> Resume:
        """Return a reader of the events that a stream missed after the event with this id."""
        return Resume(last_id, self.history, self._quantities, self._clock)

    def now(self) -> datetime | None:
        """Return the current time in UTC; None: not known."""
        return self._clock.utc(self._clock.monotonic_ns())

    def _trend_query(self, query: Query) -> Callable[[Reader], str]:
        from_us, to_us = self._span(query)
        points = query.integer("points", POINTS, 1, MAX_POINTS)
        if from_us >= to_us:
            return lambda reader: _text_of(_columns(Trend("none", 0, ()), reader))
        return lambda reader: _text_of(_columns(reader.trend(from_us, to_us, points), reader))

    def _events_query(self, query: Query) -> Callable[[Reader], str]:
        from_us, to_us = self._span(query, from_s=0.0)
        limit = query.integer("limit", EVENTS, 1, MAX_EVENTS)
        before = query.integer("before", 2**53, 0, 2**53)
        kind = query.text("kind")
        if kind is not None and kind not in set(EventKind):
            raise _unusable(f"kind is invalid; possible: {', '.join(EventKind)}")

        def read(reader: Reader) -> str:
            found = reader.events(from_us, to_us, () if kind is None else [kind], limit, before)
            return _text_of(models.Events(events=list(map(event_of, found))))

        return read

    def _span(self, query: Query, from_s: float = -SPAN_S) -> tuple[int, int]:
        """Return start and end of a query, µs since 1970; negative times count from now."""
        now = self.now()
        now_s = 0.0 if now is None else now.timestamp()

        def absolute_us(second: float) -> int:
            return round(min(max(now_s + second if second < 0 else second, 0), LAST_S) * _US)

        return absolute_us(query.number("from", from_s)), absolute_us(query.number("to", now_s + 1))

    async def _answer(self, request: Request, made: Callable[[Query], Callable[[Reader], str]]) -> Response:
        read = made(Query(request))
        return await self.history.ask(
            lambda reader: compressed(request, Response(read(reader), media_type="application/json"))
        )


class Query:
    """Parameters of a request, each at most once."""

    def __init__(self, request: Request) -> None:
        self._given = request.query_params.multi_items()

    def text(self, name: str) -> str | None:
        """Return a parameter as received; None: it is missing. Raises Refused if it is given twice."""
        values = [value for key, value in self._given if key == name]
        if len(values) > 1:
            raise _unusable(f"{name} is given twice")
        return values[0] if values else None

    def number(self, name: str, otherwise: float) -> float:
        """Return a time in seconds; raises Refused for text, and for times beyond ±``LAST_S``."""
        text = self.text(name)
        try:
            number = otherwise if text is None else float(text)
        except ValueError as error:
            raise _unusable(f"{name} is not a number") from error
        if not -LAST_S <= number <= LAST_S:
            raise _unusable(f"{name} is not a time in seconds")
        return number

    def integer(self, name: str, otherwise: int, low: int, high: int) -> int:
        """Return a whole number; raises Refused unless it is from ``low`` to ``high``."""
        text = self.text(name)
        if text is None:
            return otherwise
        if not (text.isascii() and text.isdigit() and len(text) <= 16 and low <= int(text) <= high):
            raise _unusable(f"{name} is not a whole number from {low} to {high}")
        return int(text)


def _unusable(sentence: str) -> Refused:
    """Return the refusal of an invalid query."""
    return Refused(refusal(400, sentence))


def _text_of(document: Answer) -> str:
    return dumps(document.as_object(), allow_nan=False)


def _columns(trend: Trend, reader: Reader) -> models.Trend:
    points = trend.points
    quantities: dict[str, models.TrendOfQuantity] = {}
    for key in reader.summarised:
        known = [point.values.get(key) for point in points]
        quantities[key] = models.TrendOfQuantity(
            mean=[None if value is None else value.mean for value in known],
            sigma=[None if value is None else value.sigma for value in known],
            low=[None if value is None else value.low for value in known],
            high=[None if value is None else value.high for value in known],
        )
    return models.Trend(
        source=trend.source,
        span_s=trend.span_us / _US,
        t_s=[point.t_us / _US for point in points],
        n=[point.n for point in points],
        n_valid=[point.n_valid for point in points],
        worst=[point.worst for point in points],
        worst_code=[point.worst_code for point in points],
        lost_to=[point.lost_to for point in points],
        quantities=quantities,
    )


def event_of(event: StoredEvent) -> models.Event:
    """Return an event of the history as it is sent."""
    shown = asdict(event)
    return models.Event(id=shown.pop("id"), time=time_of(shown.pop("t_us")), **shown)
