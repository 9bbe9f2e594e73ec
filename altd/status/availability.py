"""Share of time with valid measurements: last hour, day and 31 days, and since the start."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

from altd.records import utc_text
from altd.status.answer import Answer
from altd.status.health import duration

MAX_GAP_S = 5.0
"""Maximum time between two observations; a longer gap is lost: the process was stopped and measured
nothing."""

NOT_WATCHED = "not_watched"
"""Reason for time that was not observed."""

NOT_RUNNING = "not_running"
"""Reason for time before this start in which, according to the history, no daemon ran."""

MONTH_S = 31 * 86_400
"""Length of the time before this start that is counted."""

_MINUTE_NS = 60 * 10**9
_HOUR_NS = 60 * _MINUTE_NS
_SPANS = {"last_hour": (_MINUTE_NS, 60), "last_day": (_MINUTE_NS, 1440), "last_31_days": (_HOUR_NS, 744)}
"""Tally length of each span, ns, and its number of tallies."""

SHARES_INTERVAL_S = 10.0
"""Minimum interval between counts of the shares: counting 31 days takes milliseconds."""

SPANS = (*_SPANS, "since_start")
"""Names of the spans of time."""


def span_text(name: str, observed_s: float) -> str:
    """Text of one of ``SPANS``: ``of the last 3 min`` while no more than that is observed."""
    if name not in _SPANS:
        return "since the start"
    tally_ns, count = _SPANS[name]
    is_whole = observed_s >= (count - 1) * tally_ns * 1e-9
    return f"of the {name.replace('_', ' ')}" if is_whole else f"of the last {duration(observed_s)}"


@dataclass(frozen=True, slots=True)
class RunningSpan:
    """Time in which an earlier daemon ran; it ended ``ended_s`` before this daemon's start.

    ``valid`` is the share of it with valid measurements, ``lost_to`` the worst reason of the rest.
    """

    ended_s: float
    length_s: float
    valid: float
    lost_to: str


@dataclass(frozen=True, slots=True)
class Before:
    """Time before this start: known for ``known_s``, with the spans in which a daemon ran, newest first.

    The spans do not overlap.
    """

    known_s: float = 0.0
    spans: Sequence[RunningSpan] = ()


class Span(Answer):
    """Share of a time span in which the measurement was valid."""

    share: float | None
    valid_s: float
    observed_s: float
    lost_s: dict[str, float]
    """Lost time by the code of its reason, s."""
    since: str | None
    """Start of the observed time, UTC, not earlier than the span's name implies; null: not known."""


@dataclass(slots=True)
class _Tally:
    """Valid time and lost time by reason, ns."""

    valid_ns: int = 0
    lost_ns: Counter[str] = field(default_factory=Counter)

    def add(self, span_ns: int, lost_to: str | None) -> None:
        if lost_to is None:
            self.valid_ns += span_ns
        else:
            self.lost_ns[lost_to] += span_ns

    def merge(self, other: _Tally) -> None:
        self.valid_ns += other.valid_ns
        self.lost_ns.update(other.lost_ns)

    @property
    def observed_ns(self) -> int:
        return self.valid_ns + self.lost_ns.total()

    def until(self, now: datetime | None) -> Span:
        observed_ns = self.observed_ns
        since = None if now is None else now - timedelta(microseconds=observed_ns / 1000)
        return Span(
            share=round(self.valid_ns / observed_ns, 5) if observed_ns else None,
            valid_s=round(self.valid_ns * 1e-9, 1),
            observed_s=round(observed_ns * 1e-9, 1),
            lost_s={reason: round(ns * 1e-9, 1) for reason, ns in self.lost_ns.most_common() if ns},
            since=None if since is None else utc_text(since),
        )


@dataclass(slots=True)
class _Ring:
    """Time in tallies of equal length since the start; the newest are kept."""

    length_ns: int
    tallies: deque[tuple[int, _Tally]]

    def add(self, begun_ns: int, end_ns: int, lost_to: str | None) -> None:
        """Add a span of time, in ns since the start."""
        while begun_ns < end_ns:
            number = begun_ns // self.length_ns
            until_ns = min((number + 1) * self.length_ns, end_ns)
            if not self.tallies or self.tallies[-1][0] != number:
                self.tallies.append((number, _Tally()))
            self.tallies[-1][1].add(until_ns - begun_ns, lost_to)
            begun_ns = until_ns

    def newest(self, count: int, now_ns: int) -> _Tally:
        """Return the sum of the newest tallies, including the current one."""
        now = max(now_ns - 1, 0) // self.length_ns
        whole = _Tally()
        for number, tally in self.tallies:
            if number > now - count:
                whole.merge(tally)
        return whole


class Availability:
    """Counts on the monotonic clock, which is independent of the time of day, in steps of one minute.

    Time is valid if the measurement was valid at both of two consecutive observations; otherwise it is lost
    to the reason observed last. The hour and the day consist of whole minutes and the current one, the 31
    days of hours. ``before`` gives the time before this start; where it is unknown, time is not observed, and
    a span is shorter than its name. Memory: a tally for each of 1,440 minutes and 744 hours.
    """

    def __init__(self, started_ns: int, utc: Callable[[int], datetime | None] | None = None) -> None:
        self.before = Before()
        self.started_ns = started_ns
        self._utc = utc
        self._last_ns = started_ns
        self._last: str | None = "starting"
        self._since_start = _Tally()
        self._shares: Mapping[str, float | None] | None = None
        self._shares_ns = started_ns
        self._rings = {
            length_ns: _Ring(
                length_ns, deque(maxlen=max(n for of_ns, n in _SPANS.values() if of_ns == length_ns))
            )
            for length_ns in (_MINUTE_NS, _HOUR_NS)
        }

    def update(self, now_ns: int, lost_to: str | None) -> None:
        """Record that the unit measures at this moment (None), or the reason why it does not."""
        begun_ns, self._last_ns = self._last_ns, now_ns
        before, self._last = self._last, lost_to
        if now_ns - begun_ns > MAX_GAP_S * 1e9:
            why: str | None = NOT_WATCHED
        else:
            why = before if lost_to is None else lost_to
        for ring in self._rings.values():
            ring.add(begun_ns - self.started_ns, now_ns - self.started_ns, why)
        if now_ns > begun_ns:
            self._since_start.add(now_ns - begun_ns, why)

    def shares(self) -> Mapping[str, float | None]:
        """Return the share of each of ``SPANS``, counted at most every ``SHARES_INTERVAL_S``."""
        if self._shares is None or self._last_ns - self._shares_ns >= SHARES_INTERVAL_S * 1e9:
            self._shares = {name: span.share for name, span in self.spans().items()}
            self._shares_ns = self._last_ns
        return self._shares

    def spans(self) -> dict[str, Span]:
        """Return each of ``SPANS`` up to the last observation."""
        running_ns = self._last_ns - self.started_ns
        now = None if self._utc is None else self._utc(self._last_ns)
        spans: dict[str, Span] = {}
        for name, (length_ns, count) in _SPANS.items():
            whole = self._rings[length_ns].newest(count, running_ns)
            self._add_before(whole, count * length_ns - running_ns)
            spans[name] = whole.until(now)
        return spans | {"since_start": self._since_start.until(now)}

    def _add_before(self, whole: _Tally, missing_ns: int) -> None:
        """Add the known part of this time before the start."""
        missing_s = min(missing_ns * 1e-9, self.before.known_s)
        running_s = valid_s = 0.0
        lost_s: dict[str, float] = {}
        for span in self.before.spans:
            length_s = min(span.length_s, missing_s - span.ended_s)
            if length_s <= 0:
                break
            running_s += length_s
            valid_s += length_s * span.valid
            if span.valid < 1:
                lost_s[span.lost_to] = lost_s.get(span.lost_to, 0.0) + length_s * (1 - span.valid)
        whole.add(round(valid_s * 1e9), None)
        for reason, seconds in lost_s.items():
            whole.add(round(seconds * 1e9), reason)
        if missing_s > running_s:
            whole.add(round((missing_s - running_s) * 1e9), NOT_RUNNING)
