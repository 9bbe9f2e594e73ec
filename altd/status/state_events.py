"""Notes as events what the unit's state, its causes and its self-checks do, by looking at them regularly."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from altd.ports import Clock
from altd.reasons import Signal
from altd.status.cause import Kind, ShownCause, StateReport
from altd.status.event_log import EventKind, EventLog
from altd.status.self_check_desk import SelfCheckDesk
from altd.status.state import TICK_S

_SEVERITY_OF_VERDICT = {"good": 0, "suspect": 1, "bad": 4}
_SEVERITY_WITHOUT_VERDICT = 1


class StateEvents:
    """One daemon's observer. A cause is shown for 2 s at least, so none is missed between two looks."""

    def __init__(
        self, log: EventLog, read_state: Callable[[], StateReport], desk: SelfCheckDesk, clock: Clock
    ) -> None:
        self._log = log
        self._read_state = read_state
        self._desk = desk
        self._clock = clock
        self._signal: Signal | None = None
        self._causes: dict[tuple[Kind, str | None], ShownCause] = {}
        self._checks = 0
        desk.on_ask = self._note_request

    async def run(self) -> None:
        """Look until cancelled."""
        while True:
            self.look()
            await self._clock.sleep(TICK_S)

    def look(self) -> None:
        """Note what is otherwise than at the last look."""
        self._log.release(self._clock.monotonic_ns())
        report = self._read_state()
        self._look_at_causes(report)
        self._look_at_signal(report)
        self._look_at_self_checks()

    def _look_at_causes(self, report: StateReport) -> None:
        now = {(shown.cause.kind, shown.cause.of): shown for shown in report.causes}
        for key, shown in now.items():
            if key not in self._causes:
                kind, cause = shown.cause.kind, shown.cause
                detail = {"code": str(kind), "remedy": kind.remedy, "detail": cause.detail}
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

    def _look_at_signal(self, report: StateReport) -> None:
        if report.signal is self._signal:
            return
        severity = max(report.signal.severity, 0 if self._signal is None else self._signal.severity)
        before = None if self._signal is None else str(self._signal)
        detail = {"signal": str(report.signal), "before": before}
        self._log.note(EventKind.STATE, str(report.signal).replace("_", " "), None, severity, detail)
        self._signal = report.signal

    def _look_at_self_checks(self) -> None:
        latest = self._desk.latest
        if latest is None or latest.number == self._checks:
            return
        self._checks = latest.number
        verdict = str(latest.document.get("verdict"))
        keys = ("verdict", "number", "cause", "exposures_lost")
        detail = {key: latest.document[key] for key in keys if key in latest.document}
        if shifts := _shifts_px(latest.document.get("targets")):
            detail["shift_px"] = shifts
        severity = _SEVERITY_OF_VERDICT.get(verdict, _SEVERITY_WITHOUT_VERDICT)
        self._log.note(EventKind.SELF_CHECK, latest.sentence, None, severity, detail)

    def _note_request(self, by: str) -> None:
        self._log.note(EventKind.REQUEST, "a self-check was asked for", by)


def _shifts_px(targets: object) -> dict[str, object]:
    """By target, how far its frame LEDs have moved, u and v in px; None where that is not known."""
    if not isinstance(targets, Mapping):
        return {}
    return {name: of.get("shift_px") for name, of in targets.items() if isinstance(of, Mapping)}
