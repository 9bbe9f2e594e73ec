"""The inclinometer's task: reads it indefinitely, and adds its newest roll to each measurement.

A failing sensor affects nothing else: its calls block in a separate thread, and a measurement gets the last
reading without waiting.

The beam in the unit and the unit against gravity give the beam's own inclination, which stays constant while
the machine moves. ``Witness`` compares it with the surveyed one or an earlier mean: refraction, a moved
laser, or a wrong pitch changes it.
"""

from __future__ import annotations

import logging
import math
from dataclasses import replace

from altd.acquisition.inclination.alignment import Alignment
from altd.acquisition.inclination.judging import InclinationJudge
from altd.acquisition.inclination.witness import Witness, inclination
from altd.config import InclinometerSettings, Installation, Machine
from altd.ports import (
    Clock,
    Inclinometer,
    InclinometerDisturbedError,
    InclinometerError,
    InclinometerReading,
    InclinometerTimeoutError,
)
from altd.reasons import Reason
from altd.records import Fault, Finding, Measurement, Value
from altd.records.sensors import Quality, SensorValue
from altd.runtime.supervision import Limits, Works, keep_device
from altd.runtime.threads import DeviceThread
from altd.status.health import Component, State

log = logging.getLogger("altd")

ROLL = "roll_deg"
"""Key of the quantity that an inclinometer measures."""

_CALL_TIMEOUT_S = 1.0
"""Maximum time of a call. A reading takes 0.1 s, a failed one 0.5 s; after this time the port hangs."""
_LIMITS = Limits(0.2, 1.0, open_s=10.0)
"""It is reopened soon, for the person who has just plugged in a cable. Opening takes long for a USB adapter:
every request goes over its bus."""
_MAX_FAILURES = 3
"""Number of consecutive failures after which the port is reopened."""


def stated_inclination(machine: Machine | None) -> Value | None:
    """Return the beam's surveyed inclination, degrees; None: it is not stated with its uncertainty."""
    if machine is None or machine.beam_inclination_sigma_mm_per_m is None:
        return None
    slope = machine.beam_inclination_mm_per_m / 1000.0
    per_slope_deg = math.degrees(1.0) / (1.0 + slope**2)
    return Value(
        math.degrees(math.atan(slope)), machine.beam_inclination_sigma_mm_per_m / 1000.0 * per_slope_deg
    )


class InclinationMonitor:
    """Reads one inclinometer. ``sense`` returns its roll for a measurement.

    ``installation`` converted the beam's direction for the controller; the comparison with gravity reverts
    that. ``alignment`` is from ``altd level``, ``stated`` the beam's surveyed inclination, degrees.
    """

    def __init__(  # noqa: PLR0913  a device, its settings, and what is known of the installation
        self,
        driver: Inclinometer,
        settings: InclinometerSettings,
        installation: Installation,
        component: Component,
        clock: Clock,
        alignment: Alignment | None = None,
        stated: Value | None = None,
    ) -> None:
        self._driver = driver
        self._settings = settings
        self._installation = installation
        self._component = component
        self._clock = clock
        self._judge = InclinationJudge(settings, driver.accuracy, alignment)
        self._latest = SensorValue(Quality.STARTING, "the inclinometer has not been read yet")
        self._failure: SensorValue | None = None
        """The failure since the last reading; None: the last call succeeded."""
        self._logged: Quality | None = None
        self._witness = Witness(settings.divergence_sigmas, stated)

    def sense(self, measurement: Measurement) -> Finding:
        """Return the roll of a measurement, and whether its beam diverges from gravity.

        Roll is the mean over the time of its exposures, or the newest reading.
        """
        now_ns = self._clock.monotonic_ns()
        said, faults = self._latest.at(now_ns), list[Fault]()
        if said.value is not None:
            if measurement.valid and self._judge.credible:
                begin_ns, end_ns = 2 * measurement.t_ns - measurement.light_ns, measurement.light_ns
                said = self._judge.mean(said, begin_ns, end_ns)
                self._compare(measurement, said, self._judge.mean_pitch_deg(begin_ns, end_ns))
            said = replace(said, age_s=(now_ns - said.t_ns) * 1e-9)
        else:
            said = self._failure or said
            faults.append(Fault(Reason.ROLL_MISSING, detail=said.detail))
        away = self._witness.difference(now_ns)
        if away is not None and self._witness.is_away(away):
            detail = (
                f"the beam's inclination is off by {away.value:+.3f} deg, its uncertainty {away.sigma:.3f}"
            )
            faults.append(Fault(Reason.PITCH_DIVERGES, detail=detail))
            if self._settings.divergence == "invalid" and measurement.valid:
                faults.insert(0, Fault(Reason.IMPLAUSIBLE, detail=detail))
                return Finding(tuple(faults), withdraws=True, from_sensors={ROLL: said})
        return Finding(tuple(faults), from_sensors={ROLL: said})

    async def run(self) -> None:
        """Read until cancelled."""
        await keep_device(self._driver, self._read_on, self._fail, _LIMITS, self._component)

    async def _read_on(self, thread: DeviceThread, works: Works) -> None:
        """Read at intervals; raises errors after which the port must be reopened."""
        self._judge.restart()
        failures = 0
        due_ns = self._clock.monotonic_ns()
        while True:
            try:
                reading = await thread.call(self._driver.read, within_s=_CALL_TIMEOUT_S)
            except (InclinometerTimeoutError, InclinometerDisturbedError) as error:
                failures += 1
                if failures == _MAX_FAILURES:
                    raise
                self._fail(error)
            else:
                failures = 0
                works()
                self._take(reading)
            now_ns = self._clock.monotonic_ns()
            due_ns = max(due_ns + round(self._settings.interval_s * 1e9), now_ns)
            await self._clock.sleep((due_ns - now_ns) * 1e-9)

    def _compare(self, measurement: Measurement, roll: SensorValue, gravity_deg: float) -> None:
        """Add the beam's inclination of a measurement to the comparison; nothing with one axis."""
        newest, pitch = self._judge.credible[-1], measurement.known("pitch_deg")
        yaw_deg = measurement.number("yaw_deg")
        if not newest.has_pitch or pitch is None or yaw_deg is None or roll.value is None:
            return
        of, place = newest.tilt, self._installation
        slopes = (
            math.tan(math.radians(place.sign_yaw * (yaw_deg - place.offset_yaw_deg))),
            math.tan(math.radians(place.sign_pitch * (pitch.value - place.offset_pitch_deg))),
        )
        unit = Value(roll.value, of.sigma_roll_deg), Value(gravity_deg, of.sigma_pitch_deg)
        self._witness.add(inclination(self._clock.monotonic_ns(), slopes, pitch, unit, newest.sensor_deg))

    def _take(self, reading: InclinometerReading) -> None:
        said = self._judge.roll(reading)
        self._latest, self._failure = said, None
        self._component.count("readings")
        figures = {
            "roll_deg": _rounded(said.value, 3),
            "sigma_deg": _rounded(said.sigma, 3),
            "noise_deg": _rounded(self._judge.noise_deg, 4),
            "temperature_c": round(reading.temperature_c, 1),
            "longest_still_s": round(self._judge.longest_still_s, 1),
        }
        if reading.pitch_deg is not None and self._judge.credible:
            away = self._witness.difference(self._clock.monotonic_ns())
            figures["gravity_pitch_deg"] = round(self._judge.credible[-1].tilt.pitch_deg, 3)
            figures["pitch_divergence_deg"] = _rounded(None if away is None else away.value, 4)
            figures["pitch_divergence_sigma_deg"] = _rounded(None if away is None else away.sigma, 4)
        self._component.observe(figures)
        self._report(said)

    def _fail(self, error: Exception, _: int = 0) -> str:
        """Note a failure; after a lost or disturbed response, keep the last reading until it is too old."""
        said = _in_words(error)
        self._component.count("failures")
        self._failure = said
        is_passing = isinstance(error, InclinometerTimeoutError | InclinometerDisturbedError)
        if not (is_passing and self._latest.at(self._clock.monotonic_ns()).value is not None):
            self._latest = said
            self._report(said, error if said.quality is Quality.DEFECT else None)
        return ""

    def _report(self, said: SensorValue, defect: Exception | None = None) -> None:
        """Report to health, and write a line to the log when the quality changes."""
        known = said.value is not None
        starting = said.quality is Quality.STARTING
        state = State.OK if known else State.STARTING if starting else State.FAILED
        self._component.set_state(state, self._driver.name if known else said.detail)
        quality = None if known or starting else said.quality
        if quality not in (None, self._logged):
            log.warning("%s: %s", self._component.name, said.detail, exc_info=defect)
        self._logged = quality


def _in_words(error: Exception) -> SensorValue:
    match error:
        case InclinometerError():
            return SensorValue(error.quality, str(error))
        case TimeoutError():
            return SensorValue(Quality.NO_PORT, "the port hangs: unplug it and plug it in again")
    return SensorValue(Quality.DEFECT, f"{type(error).__name__}: {error}")


def _rounded(value: float | None, decimals: int) -> float | None:
    return None if value is None else round(value, decimals)
