"""The measurement and the unit that the pages show."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

from altd.publish.example import MEASURED
from altd.records import Fault, Reason
from altd.service.health import Health, State

SPOT_LOST = replace(
    MEASURED,
    sequence=180,
    time=datetime(2026, 11, 20, 8, 15, 31, 125_000, UTC),
    beam=None,
    points_mm={"front": None, "rear": None},
    status=(Fault(Reason.SPOT_MISSING, "front"), Fault(Reason.SPOT_MISSING, "rear")),
)


class _TwoHoursLater:
    """The clock of a unit that has been up for a while."""

    def __init__(self) -> None:
        self.now_ns = 0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def utc(self, t_ns: int) -> datetime | None:
        return None

    async def sleep(self, seconds: float) -> None:
        return None


def health() -> Health:
    """A unit whose beam is blocked while all of its parts work."""
    clock = _TwoHoursLater()
    unit = Health(clock)
    unit.facts |= {"serial": "ALT-0007", "version": "0.1.0", "calibration": "2026-11-02, residual 0.021 mm"}
    for name, message in (
        ("camera front", "20.0 frames/s"),
        ("camera rear", "20.0 frames/s"),
        ("serial /dev/ttyS1", "telegram every 1 s on /dev/ttyS1, 9600 baud 8N1"),
    ):
        unit.component(name).say(State.OK, message)
    clock.now_ns = 7_380_000_000_000
    return unit
