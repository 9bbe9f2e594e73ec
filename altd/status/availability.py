"""The share of time in which the unit measured: of the last hour, the last day and since the start."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field

MAX_GAP_S = 5.0
"""Time between two looks that are further apart is lost: the process stood still, and nobody measured."""

NOT_WATCHED = "not_watched"
"""The reason for time in which nobody looked."""

_MINUTE_NS = 60 * 10**9
_SPANS_MIN = {"last_hour": 60, "last_day": 1440}


@dataclass(slots=True)
class _Tally:
    """Time by what it was, ns."""

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

    def as_object(self) -> dict[str, object]:
        observed_ns = self.valid_ns + self.lost_ns.total()
        lost = {reason: round(ns * 1e-9, 1) for reason, ns in self.lost_ns.most_common() if ns}
        return {
            "share": round(self.valid_ns / observed_ns, 5) if observed_ns else None,
            "valid_s": round(self.valid_ns * 1e-9, 1),
            "observed_s": round(observed_ns * 1e-9, 1),
            "lost_s": lost,
        }


class Availability:
    """Counts on the monotonic clock, which no setting of the time of day moves; a minute is the finest.

    Time is valid when the measurement was so at both of two looks that follow each other; else it is lost to
    the reason that was seen later. Only time in which the daemon ran is observed: a span is shorter than its
    name says until it has passed, and ``observed_s`` tells how long it is. The hour and the day hold whole
    minutes and the one that has begun. Memory: a tally for each of 1,440 minutes.
    """

    def __init__(self, started_ns: int) -> None:
        self._started_ns = started_ns
        self._last_ns = started_ns
        self._last: str | None = "starting"
        self._since_start = _Tally()
        self._minutes: deque[tuple[int, _Tally]] = deque(maxlen=max(_SPANS_MIN.values()))

    def look(self, now_ns: int, lost_to: str | None) -> None:
        """The unit measures at this moment (None), or why it does not."""
        begun_ns, self._last_ns = self._last_ns, now_ns
        before, self._last = self._last, lost_to
        if now_ns - begun_ns > MAX_GAP_S * 1e9:
            why: str | None = NOT_WATCHED
        else:
            why = before if lost_to is None else lost_to
        while begun_ns < now_ns:
            minute = (begun_ns - self._started_ns) // _MINUTE_NS
            end_ns = min(self._started_ns + (minute + 1) * _MINUTE_NS, now_ns)
            self._tally_of(minute).add(end_ns - begun_ns, why)
            self._since_start.add(end_ns - begun_ns, why)
            begun_ns = end_ns

    def as_object(self) -> dict[str, object]:
        """Share, valid, observed and lost seconds of each span, as plain JSON types."""
        now_minute = max(self._last_ns - self._started_ns - 1, 0) // _MINUTE_NS
        spans: dict[str, object] = {}
        for name, minutes in _SPANS_MIN.items():
            whole = _Tally()
            for minute, tally in self._minutes:
                if minute > now_minute - minutes:
                    whole.merge(tally)
            spans[name] = whole.as_object()
        return spans | {"since_start": self._since_start.as_object()}

    def _tally_of(self, minute: int) -> _Tally:
        if not self._minutes or self._minutes[-1][0] != minute:
            self._minutes.append((minute, _Tally()))
        return self._minutes[-1][1]
