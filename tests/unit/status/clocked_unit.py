"""Board, health and state of a unit on a clock that the test drives."""

from dataclasses import replace

from support.clock import FakeClock
from support.measurements import measurement

from altd.instruments.beam.instrument import QUANTITIES
from altd.reasons import Reason
from altd.records import Fault
from altd.status.board import Board
from altd.status.cause import Cause, StateReport
from altd.status.health import Health
from altd.status.state import UnitState
from altd.status.unit import PublishedUnit

STALE_AFTER_S = 1.0


class Unit:
    """Board, health and state of a unit on a clock that the test drives; it runs for a minute already."""

    def __init__(self, running_s: float = 60.0) -> None:
        self.clock = FakeClock()
        self.board = Board(self.clock, STALE_AFTER_S, QUANTITIES)
        self.health = Health(self.clock)
        self.watched: list[Cause] = []
        self.state = UnitState(self.board, self.health, self.clock, [lambda now_ns: self.watched])
        self.published = PublishedUnit(self.board, self.health, state=self.state.read)
        self.clock.now_ns = round(running_s * 1e9)
        self._sequence = 0

    def publish(self, *status: Fault, valid: bool | None = None) -> None:
        """A measurement of this moment with this status, valid if that allows it."""
        self._sequence += 1
        is_valid = all(fault.reason.is_warning for fault in status) if valid is None else valid
        spoilt = () if is_valid else (Reason.SPOT_MISSING,)
        made = measurement(self._sequence, self.clock.now_ns, *spoilt)
        self.board.publish(replace(made, status=status))

    def measure(self, *status: Fault, for_s: float = 0.0, every_s: float = 0.5) -> StateReport:
        """Measure so for that long, and return the state at its end."""
        end_ns = self.clock.now_ns + round(for_s * 1e9)
        while True:
            self.publish(*status)
            report = self.state.read()
            if self.clock.now_ns >= end_ns:
                return report
            self.clock.now_ns += round(every_s * 1e9)


def kinds(report: StateReport) -> set[str]:
    return {str(shown.cause.kind) for shown in report.causes}
