"""Causes of the unit's state, held long enough to be noticed, and the worst of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from altd.reasons import Reason, Signal
from altd.records import FaultCause
from altd.status.availability import Availability
from altd.status.conditions import Condition

Kind = Reason | Condition
"""Common type of both tables of causes: code, signal, brief, remedy, meaning."""

HOLD_S = 2.0
"""Time a cause is still shown after it was last true, s. Polling once a second misses none, and a cause that
toggles with the frames is one cause, not twenty per second."""

MAINTENANCE_DELAY_S = 10.0
"""Time a cause must be true before maintenance is required, and the longest pause in it, s. An occasional
lost frame does not require a technician. Anything worse than maintenance is shown at once, because a state
must never be better than the measurement."""


@dataclass(frozen=True, slots=True)
class Cause:
    """A present fault; ``of`` names the target or component, None: the whole unit."""

    kind: Kind
    of: str | None = None
    detail: str = ""
    known: FaultCause | None = None

    @property
    def remedy(self) -> str:
        """Remedy of the cause, as far as it is known."""
        return self.kind.remedy if self.known is None else self.known.remedy


@dataclass(frozen=True, slots=True)
class ShownCause:
    """A cause, its begin (monotonic ns), whether it is true now, and its number of occurrences."""

    cause: Cause
    since_ns: int
    is_active: bool
    times: int

    @property
    def signal(self) -> Signal:
        """Signal of the unit for this cause."""
        return signal_of(self.cause.kind)


def signal_of(kind: Kind) -> Signal:
    """Return the signal of a cause. A fault is never good, even if its table states that."""
    signal = getattr(kind, "signal", None)
    if not isinstance(signal, Signal) or signal is Signal.GOOD:
        return Signal.FAILURE
    return signal


def worst(causes: Iterable[ShownCause]) -> Signal:
    """Return the signal that is shown for all causes; good if there are none."""
    return max((cause.signal for cause in causes), key=lambda signal: signal.severity, default=Signal.GOOD)


@dataclass(slots=True)
class _Seen:
    cause: Cause
    since_ns: int
    last_ns: int
    is_active: bool = True
    times: int = 1


class CauseFilter:
    """Holds intermittent causes, so that the state does not flicker; the caller passes the time."""

    def __init__(self) -> None:
        self._seen: dict[tuple[Kind, str | None], _Seen] = {}

    def update(self, causes: Iterable[Cause], now_ns: int) -> tuple[ShownCause, ...]:
        """Update with the present causes; returns the shown ones, the worst first, then the oldest.

        A failed camera comes before the missing frames that it explains.
        """
        now = {(cause.kind, cause.of): cause for cause in causes}
        for key, seen in list(self._seen.items()):
            if key not in now:
                seen.is_active = False
            if not seen.is_active and now_ns - seen.last_ns > _hold_ns(seen.cause.kind):
                del self._seen[key]
        for key, cause in now.items():
            known = self._seen.get(key)
            if known is None:
                self._seen[key] = _Seen(cause, now_ns, now_ns)
                continue
            known.times += not known.is_active
            known.cause, known.last_ns, known.is_active = cause, now_ns, True
        shown = [
            ShownCause(seen.cause, seen.since_ns, seen.is_active, seen.times)
            for seen in self._seen.values()
            if _is_shown(seen)
        ]

        def rank(shown: ShownCause) -> tuple[int, bool, int]:
            return -shown.signal.severity, shown.cause.kind is not Condition.CAMERA_FAILED, shown.since_ns

        return tuple(sorted(shown, key=rank))


def _hold_ns(kind: Kind) -> int:
    is_maintenance = signal_of(kind) is Signal.MAINTENANCE_REQUIRED
    return round((MAINTENANCE_DELAY_S if is_maintenance else HOLD_S) * 1e9)


def _is_shown(seen: _Seen) -> bool:
    if signal_of(seen.cause.kind) is not Signal.MAINTENANCE_REQUIRED:
        return True
    return seen.last_ns - seen.since_ns >= MAINTENANCE_DELAY_S * 1e9


@dataclass(frozen=True, slots=True)
class StateReport:
    """State of the unit at one moment: its signal, since when, and every cause."""

    signal: Signal
    since_ns: int
    now_ns: int
    causes: tuple[ShownCause, ...]
    availability: Availability

    @property
    def needs_attention(self) -> bool:
        """Whether a fault other than the measurement's needs attention now."""
        return any(
            isinstance(shown.cause.kind, Condition)
            and shown.is_active
            and shown.signal is not Signal.CHECK_FUNCTION
            for shown in self.causes
        )
