"""Example measurement and unit state on the pages of the serial interfaces."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from altd.config import ConsolePortSettings, TelegramPortSettings
from altd.instruments.beam.instrument import QUANTITIES
from altd.ports import Stop
from altd.publish.serial.publisher import console_message, telegram_message
from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.status.board import Board
from altd.status.health import MEASURING, Health, State
from altd.status.unit import PublishedUnit, UnitFacts
from tools.pages.example import MEASURED

SPOT_LOST = replace(
    MEASURED,
    sequence=180,
    time=datetime(2026, 11, 20, 8, 15, 31, 125_000, UTC),
    values={},
    motions={},
    targets={"front": None, "rear": None},
    status=(
        Fault(Reason.SPOT_MISSING, "front", "nothing is brighter than the background"),
        Fault(Reason.SPOT_MISSING, "rear", "nothing is brighter than the background"),
    ),
)


class _TwoHoursLater:
    """Clock of a unit that has been running for two hours."""

    def __init__(self) -> None:
        self.now_ns = 0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def utc(self, t_ns: int) -> datetime | None:
        return None

    async def sleep(self, seconds: float) -> None:
        return None

    def wait(self, stop: Stop, seconds: float) -> None:
        return None


class _Shows(Board):
    """A board with one measurement, always of the same age."""

    def __init__(self, measurement: Measurement | None, age_s: float | None) -> None:
        super().__init__(_TwoHoursLater(), 1.0, QUANTITIES)
        self._shown = measurement
        self._age_s = age_s

    def read(self) -> Measurement | None:
        return self._shown

    def age_s(self) -> float | None:
        return self._age_s


def unit_that_shows(
    measurement: Measurement | None, components: Health | None = None, age_s: float | None = None
) -> PublishedUnit:
    """Return a unit that shows this measurement, with these components or those of ``health``."""
    facts = UnitFacts(version="0.1.0", serial="ALT-0007", calibration="2026-11-02, workshop, stage 2")
    return PublishedUnit(_Shows(measurement, age_s), components or health(), facts)


def health() -> Health:
    """Health of a unit whose beam was blocked a moment ago; all its components work."""
    clock = _TwoHoursLater()
    unit = Health(clock)
    telegram = TelegramPortSettings(device=Path("/dev/ttyS1"), speaks="telegram")
    console = ConsolePortSettings(device=Path("/dev/ttyS2"), speaks="console")
    for name, message in (
        ("camera front", ""),
        ("camera rear", ""),
        ("http 0.0.0.0:8080", "port 8080"),
        (f"serial {telegram.device}", telegram_message(telegram)),
        (f"serial {console.device}", console_message(console)),
        (MEASURING, ""),
    ):
        unit.component(name).set_state(State.OK, message)
    clock.now_ns = 7_379_000_000_000
    dark = "spot_missing, nothing is brighter than the background"
    unit.component(MEASURING).set_state(State.DEGRADED, f"front: {dark}; rear: {dark}")
    clock.now_ns = 7_380_000_000_000
    for camera in ("front", "rear"):
        unit.component(f"camera {camera}").observe(
            {"exposure_control": "auto", "level": 0.02, "exposure_ms": 2.0}
        )
        unit.component(f"camera {camera}").count("frames", 147_600)
    unit.component(f"serial {telegram.device}").count("telegrams_sent", 7380)
    unit.component(MEASURING).observe({"skew_ms": 0.02})
    unit.component(MEASURING).count("measurements", 147_581)
    return unit
