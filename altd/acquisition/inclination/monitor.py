"""The inclinometer's task: reads it indefinitely, and adds its newest roll to each measurement.

A failing sensor affects nothing else: its calls block in a separate thread, and a measurement gets the last
reading without waiting.

The beam's pitch in the unit and the unit's pitch against gravity add up to the beam's own inclination, which
stays constant while the machine moves. ``PitchDivergence`` compares it with an earlier mean: refraction or a
moved laser changes it slowly.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import replace

from altd.acquisition.inclination.judging import InclinationJudge
from altd.config import InclinometerSettings, Installation
from altd.ports import (
    Clock,
    Inclinometer,
    InclinometerDisturbedError,
    InclinometerError,
    InclinometerReading,
    InclinometerTimeoutError,
)
from altd.reasons import Reason
from altd.records import Fault, Finding, Value
from altd.records.sensors import Quality, SensorValue
from altd.runtime.supervision import Limits, Works, keep_device
from altd.runtime.threads import DeviceThread
from altd.status.health import Component, State

MEAN_S = 600.0
"""Averaging time of the reference and of the current inclination: shorter changes are vibration."""
MAX_GAP_S = 600.0
"""Maximum gap between two samples; after a longer one, perhaps with another laser, the reference is new."""
INTERVAL_S = 1.0
"""Minimum time between two samples; more samples add no information."""


class PitchDivergence:
    """Change of the beam's inclination relative to its mean over the first ten minutes."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._begin_ns = 0
        self._reference_deg = self._now_deg = 0.0
        self._samples = 0

    def add(self, t_ns: int, inclination_deg: float) -> None:
        """Add a sample of the beam's inclination against gravity."""
        since_s = math.inf if self._last_ns is None else (t_ns - self._last_ns) * 1e-9
        if since_s < INTERVAL_S:
            return
        self._last_ns = t_ns
        if since_s > MAX_GAP_S:
            self._begin_ns, self._samples = t_ns, 0
        if (t_ns - self._begin_ns) * 1e-9 < MEAN_S:
            self._samples += 1
            self._reference_deg += (inclination_deg - self._reference_deg) / self._samples
            self._now_deg = self._reference_deg
        else:
            self._now_deg += (1.0 - math.exp(-since_s / MEAN_S)) * (inclination_deg - self._now_deg)

    def divergence_deg(self, now_ns: int) -> float | None:
        """Return the current inclination minus the reference; None: not known yet, or too old."""
        if self._last_ns is None or (self._last_ns - self._begin_ns) * 1e-9 < MEAN_S:
            return None
        if (now_ns - self._last_ns) * 1e-9 > MAX_GAP_S:
            return None
        return self._now_deg - self._reference_deg


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


class InclinationMonitor:
    """Reads one inclinometer. ``sense`` returns its roll for a measurement.

    ``installation`` converted the beam's pitch for the controller; the comparison of pitch reverts that.
    """

    def __init__(
        self,
        driver: Inclinometer,
        settings: InclinometerSettings,
        installation: Installation,
        component: Component,
        clock: Clock,
    ) -> None:
        self._driver = driver
        self._settings = settings
        self._installation = installation
        self._component = component
        self._clock = clock
        self._judge = InclinationJudge(settings, driver.accuracy)
        self._latest = SensorValue(Quality.STARTING, "the inclinometer has not been read yet")
        self._failure: SensorValue | None = None
        """The failure since the last reading; None: the last call succeeded."""
        self._logged: Quality | None = None
        self._divergence = PitchDivergence()
        self._gravity_pitch_deg: float | None = None
        """Pitch against gravity of the newest reading; None: it is not credible or has no pitch."""

    def sense(self, values: Mapping[str, Value]) -> Finding:
        """Return the current roll, and whether ``values`` of a valid measurement diverge from gravity."""
        now_ns = self._clock.monotonic_ns()
        said, faults = self._latest.at(now_ns), list[Fault]()
        if said.value is not None:
            said = replace(said, age_s=(now_ns - said.t_ns) * 1e-9)
            if self._gravity_pitch_deg is not None and "pitch_deg" in values:
                self._compare_pitch(values["pitch_deg"].value, self._gravity_pitch_deg, now_ns)
        else:
            said = self._failure or said
            faults.append(Fault(Reason.ROLL_MISSING, detail=said.detail))
        divergence_deg = self._divergence.divergence_deg(now_ns)
        if divergence_deg is not None and abs(divergence_deg) > self._settings.max_divergence_deg:
            detail = f"the beam's inclination against gravity has changed by {divergence_deg:+.2f} deg"
            faults.append(Fault(Reason.PITCH_DIVERGES, detail=detail))
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

    def _compare_pitch(self, pitch_deg: float, gravity_pitch_deg: float, now_ns: int) -> None:
        """Add a sample of the beam's inclination: its pitch in the unit plus the unit's against gravity."""
        optical_deg = self._installation.sign_pitch * (pitch_deg - self._installation.offset_pitch_deg)
        self._divergence.add(now_ns, optical_deg + gravity_pitch_deg)

    def _take(self, reading: InclinometerReading) -> None:
        said = self._judge.roll(reading)
        self._latest, self._failure = said, None
        pitch_deg = self._judge.gravity_pitch_deg(reading)
        self._gravity_pitch_deg = None if said.value is None else pitch_deg
        self._component.count("readings")
        figures = {
            "roll_deg": _rounded(said.value, 3),
            "sigma_deg": _rounded(said.sigma, 3),
            "noise_deg": _rounded(self._judge.noise_deg, 4),
            "temperature_c": round(reading.temperature_c, 1),
            "longest_still_s": round(self._judge.longest_still_s, 1),
        }
        if pitch_deg is not None:
            divergence_deg = self._divergence.divergence_deg(self._clock.monotonic_ns())
            figures["gravity_pitch_deg"] = round(pitch_deg, 3)
            figures["pitch_divergence_deg"] = _rounded(divergence_deg, 3)
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
