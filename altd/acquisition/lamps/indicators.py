"""Indicator lamps on the housing, for a technician at the unit (App. A.1.4)."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from enum import Enum, auto

from altd.acquisition.lamps.controller import LampController
from altd.ports import Indicator, Indicators
from altd.reasons import Reason
from altd.records import Measurement
from altd.status.health import Component, State
from altd.status.unit import PublishedUnit

UPDATE_INTERVAL_S = 0.08
"""Time between two updates of the lamps, and duration of a Data flash: short, but visible."""

BLINK_HALF_PERIOD_NS = 500_000_000
"""Half a period of blinking: 1 Hz, all lamps in step."""

WARM_UP_S = 2.0
"""Time after its start for which a daemon without a valid measurement is warming up: cameras open slowly."""


class Validity(Enum):
    """Validity of the measurement, as far as a lamp can show it."""

    VALID = auto()
    WARNED = auto()
    WARMING_UP = auto()
    INVALID = auto()


class Light(Enum):
    """State of one lamp."""

    DARK = auto()
    BLINKS = auto()
    STEADY = auto()

    def lit_at(self, t_ns: int) -> bool:
        """Whether the lamp is lit at an instant of the monotonic clock."""
        return self is Light.STEADY or (self is Light.BLINKS and t_ns // BLINK_HALF_PERIOD_NS % 2 == 0)


OK_LIGHT = {
    Validity.VALID: Light.STEADY,
    Validity.WARNED: Light.BLINKS,
    Validity.WARMING_UP: Light.BLINKS,
    Validity.INVALID: Light.DARK,
}


def validity_of(measurement: Measurement | None, running_s: float) -> Validity:
    """Return the validity of the board's measurement (None: none yet), ``running_s`` after the start."""
    if measurement is not None and measurement.valid:
        return Validity.WARNED if measurement.status else Validity.VALID
    status = measurement.status if measurement is not None else ()
    reasons = {fault.reason for fault in status if not fault.reason.is_warning}
    if running_s < WARM_UP_S or reasons == {Reason.WARMING_UP}:
        return Validity.WARMING_UP
    return Validity.INVALID


def error_light(validity: Validity, needs_attention: bool) -> Light:
    """Return the state of the lamp Error; ``needs_attention``: a cause besides the measurement does."""
    if validity is Validity.INVALID:
        return Light.STEADY
    return Light.BLINKS if needs_attention else Light.DARK


@dataclass(slots=True)
class DataFlash:
    """The lamp Data: lit for one tick after data was sent, then dark for at least one; a stream flickers."""

    _seen: int = 0
    _lit: bool = False

    def lit(self, given: int) -> bool:
        """Return whether the lamp is lit in this tick; ``given`` is the total number of deliveries so far."""
        self._lit = given > self._seen and not self._lit
        if self._lit:
            self._seen = given
        return self._lit


class IndicatorPanel:
    """The indicator lamps, which follow the unit."""

    def __init__(self, indicators: Indicators, unit: PublishedUnit, component: Component) -> None:
        dark: frozenset[Indicator] = frozenset()
        self._controller: LampController[frozenset[Indicator]] = LampController(
            indicators, indicators.show, dark, component, unit.clock
        )
        self._unit = unit
        self._clock = unit.clock
        self._flash = DataFlash()

    async def run(self) -> None:
        """Update the lamps until cancelled; then darken them."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._controller.run(), name="indicator-controller")
            await self._follow()

    async def _follow(self) -> None:
        started_ns = self._clock.monotonic_ns()
        while True:
            now_ns = self._clock.monotonic_ns()
            self._controller.request(self._lit(now_ns, (now_ns - started_ns) * 1e-9))
            await self._clock.sleep(UPDATE_INTERVAL_S)

    def _lit(self, now_ns: int, running_s: float) -> frozenset[Indicator]:
        view = self._unit.view()
        validity = validity_of(view.measurement, running_s)
        failed = any(component.state is State.FAILED for component in view.components)
        needs_attention = failed or (view.state is not None and view.state.needs_attention)
        lit = {
            Indicator.POWER: True,
            Indicator.OK: OK_LIGHT[validity].lit_at(now_ns),
            Indicator.ERROR: error_light(validity, needs_attention).lit_at(now_ns),
            Indicator.DATA: self._flash.lit(sum(component.data_given for component in view.components)),
        }
        return frozenset(indicator for indicator, shines in lit.items() if shines)
