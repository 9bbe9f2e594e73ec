"""State of the unit in the four signals of NAMUR NE 107 besides good, its causes, and events of its changes.

Each read determines it from the board, the components and the watches, so no task can die and leave an old
state behind. The periodic task only updates the memory of causes and the availability.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from altd.ports import Clock
from altd.reasons import Signal
from altd.records import Measurement
from altd.selfcheck.records import Verdict
from altd.status.availability import Availability
from altd.status.board import Board
from altd.status.cause import Cause, CauseFilter, Kind, ShownCause, StateReport, signal_of, worst
from altd.status.causes import START_S, causes_now, is_warning
from altd.status.conditions import Condition
from altd.status.event_log import EventKind, EventLog
from altd.status.health import Health
from altd.status.services import SelfCheckService

TICK_S = 0.25
"""Interval at which the state is determined without a request."""

Watch = Callable[[int], Iterable[Cause]]
"""Faults at an instant of the monotonic clock, ns, from neither board nor component."""


class UnitState:
    """State of one daemon. ``watches`` report faults that board and health do not contain."""

    def __init__(self, board: Board, health: Health, clock: Clock, watches: Iterable[Watch] = ()) -> None:
        self._board = board
        self._health = health
        self._clock = clock
        self._watches = tuple(watches)
        self._started_ns = clock.monotonic_ns()
        self._filter = CauseFilter()
        self._signal = Signal.CHECK_FUNCTION
        self._since_ns = self._started_ns
        self.availability = Availability(self._started_ns, clock.utc)

    async def run(self) -> None:
        """Update the state regularly until cancelled."""
        while True:
            self._update()
            await self._clock.sleep(TICK_S)

    def read(self) -> StateReport:
        """Return the present state."""
        now_ns, causes = self._update()
        return StateReport(self._signal, self._since_ns, now_ns, causes, self.availability)

    def _update(self) -> tuple[int, tuple[ShownCause, ...]]:
        now_ns = self._clock.monotonic_ns()
        measurement = self._board.read()
        running_s = (now_ns - self._started_ns) * 1e-9
        causes = causes_now(measurement, self._health, now_ns, running_s)
        causes += self._watched(now_ns)
        self.availability.update(now_ns, _lost_to(measurement, running_s))
        shown = self._filter.update(causes, now_ns)
        if (signal := worst(shown)) is not self._signal:
            self._signal, self._since_ns = signal, now_ns
        return now_ns, shown

    def _watched(self, now_ns: int) -> Iterator[Cause]:
        """Yield the watches' faults. A watch that fails is a fault; it does not end the daemon."""
        for watch in self._watches:
            try:
                yield from watch(now_ns)
            except Exception as error:
                detail = f"{type(error).__name__}: {error}"
                yield Cause(Condition.COMPONENT_FAILED, getattr(watch, "__qualname__", "watch"), detail)


def _lost_to(measurement: Measurement | None, running_s: float) -> str | None:
    """Return the worst reason why nothing valid is measured, without its target; None: valid."""
    if measurement is None:
        return str(Condition.STARTING if running_s < START_S else Condition.NOTHING_MEASURED)
    if measurement.valid:
        return None
    reasons = [fault.reason for fault in measurement.status if not is_warning(fault)]
    return str(max(reasons, key=lambda reason: signal_of(reason).severity, default=Condition.UNKNOWN_REASON))


_SEVERITIES = {Verdict.GOOD: 0, Verdict.SUSPECT: 1, Verdict.BAD: 4, Verdict.UNKNOWN: 1}


class StateEvents:
    """Observer of one daemon. A cause is shown for at least 2 s, so no observation interval misses one."""

    def __init__(
        self, log: EventLog, read_state: Callable[[], StateReport], service: SelfCheckService, clock: Clock
    ) -> None:
        self._log = log
        self._read_state = read_state
        self._service = service
        self._clock = clock
        self._signal: Signal | None = None
        self._causes: dict[tuple[Kind, str | None], ShownCause] = {}
        self._checks = 0

    async def run(self) -> None:
        """Observe until cancelled."""
        while True:
            self.observe()
            await self._clock.sleep(TICK_S)

    def observe(self) -> None:
        """Note the changes since the last call."""
        self._log.release(self._clock.monotonic_ns())
        report = self._read_state()
        self._note_causes(report)
        self._note_signal(report)
        self._note_self_checks()

    def _note_causes(self, report: StateReport) -> None:
        now = {(shown.cause.kind, shown.cause.of): shown for shown in report.causes}
        for key, shown in now.items():
            if key not in self._causes:
                kind, cause = shown.cause.kind, shown.cause
                detail = {"code": str(kind), "remedy": cause.remedy, "detail": cause.detail}
                self._log.note(
                    EventKind.CAUSE_CAME, kind.brief, shown.cause.of, shown.signal.severity, detail
                )
        for key, shown in self._causes.items():
            if key not in now:
                kind = shown.cause.kind
                lasted_s = round((report.now_ns - shown.since_ns) * 1e-9, 1)
                detail_then = {"code": str(kind), "for_s": lasted_s, "times": shown.times}
                self._log.note(
                    EventKind.CAUSE_WENT, kind.brief, shown.cause.of, shown.signal.severity, detail_then
                )
        self._causes = now

    def _note_signal(self, report: StateReport) -> None:
        if report.signal is self._signal:
            return
        severity = max(report.signal.severity, 0 if self._signal is None else self._signal.severity)
        before = None if self._signal is None else str(self._signal)
        detail = {"signal": str(report.signal), "before": before}
        self._log.note(EventKind.STATE, str(report.signal).replace("_", " "), None, severity, detail)
        self._signal = report.signal

    def _note_self_checks(self) -> None:
        latest = self._service.latest
        if latest is None or latest.number == self._checks:
            return
        self._checks = latest.number
        check = latest.check
        detail: dict[str, object] = {
            "verdict": str(check.verdict),
            "number": latest.number,
            "cause": latest.cause,
            "exposures_lost": latest.exposures_lost,
        }
        if check.targets:
            detail["shift_px"] = {name: drift.shift_px for name, drift in check.targets.items()}
        self._log.note(EventKind.SELF_CHECK, check.sentence, None, _SEVERITIES[check.verdict], detail)
