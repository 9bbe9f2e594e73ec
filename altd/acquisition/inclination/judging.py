"""Plausibility and uncertainty of an inclinometer's readings. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from altd.acquisition.inclination.alignment import Alignment, Tilt
from altd.config import InclinometerSettings
from altd.ports import InclinometerAccuracy, InclinometerReading
from altd.records.sensors import Quality, SensorValue, within_half_turn

_MIN_READINGS = 4
_MAX_READINGS = 10
"""Maximum number of readings from which noise is estimated: the last two seconds."""
_MAX_CREDIBLE = 60
"""Readings that are kept for means: 3 s at the shortest interval."""
_MIN_OF_MEAN = 2
_SIGNIFICANT = 2.0
"""A rate counts if it is larger than this many of its standard deviations."""
_MIN_SAME = 3
"""Minimum number of repeated readings for a frozen sensor; fewer prove nothing, however long they take."""
_MAX_STILL_S = 60.0
"""Maximum time for which the angle alone may stay constant: later, its axis counts as dead."""
_POSSIBLE_C = (-40.0, 85.0)
"""Operating temperatures of such sensors, °C; the unit is specified for -10 to +60 °C."""
_STATED_C = 20.0
"""Temperature for which a sensor's zero is stated."""


@dataclass(frozen=True, slots=True)
class Credible:
    """A credible reading; ``tilt`` has the uncertainties without the noise. ``has_pitch``: two axes.

    ``sensor_deg`` is the standard uncertainty of the sensor's angles without its zero and noise.
    """

    t_ns: int
    tilt: Tilt
    has_pitch: bool
    sensor_deg: float


class InclinationJudge:
    """Judges one reading after the other; remembers the last seconds.

    ``alignment`` is from ``altd level``; None: the settings' offsets. ``noise_deg`` is the standard deviation
    of a reading, None before there are enough readings. ``longest_still_s`` is the longest time for which no
    value of the readings changed. ``credible`` are the last readings that were.
    """

    def __init__(
        self,
        settings: InclinometerSettings,
        accuracy: InclinometerAccuracy,
        alignment: Alignment | None = None,
    ) -> None:
        self._settings = settings
        self._accuracy = accuracy
        self._alignment = alignment
        self.noise_deg: float | None = None
        self.longest_still_s = 0.0
        self.restart()

    def restart(self) -> None:
        """Forget the readings: the sensor may have been exchanged."""
        self._rolls_deg: deque[float] = deque(maxlen=_MAX_READINGS)
        self._times_ns: deque[int] = deque(maxlen=_MAX_READINGS)
        self.credible: deque[Credible] = deque(maxlen=_MAX_CREDIBLE)
        self._last: InclinometerReading | None = None
        self._moved_ns = self._roll_moved_ns = self._same = 0
        self._has_moved = False

    def roll(self, reading: InclinometerReading) -> SensorValue:
        """Return roll as the unit publishes it, or the reason why it is not credible."""
        sensor_deg = self._sensor_deg(reading)
        tilt = self._tilt(reading, sensor_deg)
        roll_deg = tilt.roll_deg
        still = self._stillness(reading)
        self._rolls_deg.append(roll_deg)
        self._times_ns.append(reading.t_ns)
        self.noise_deg = _noise(self._rolls_deg)
        if not _POSSIBLE_C[0] <= reading.temperature_c <= _POSSIBLE_C[1]:
            text = f"its temperature cannot be: {reading.temperature_c:.1f} degC"
            return SensorValue(Quality.OUT_OF_RANGE, text)
        if max(abs(reading.roll_deg), abs(reading.pitch_deg or 0.0)) >= self._accuracy.range_deg:
            text = f"its angle is at the end of its range, {self._accuracy.range_deg:g} deg"
            return SensorValue(Quality.OUT_OF_RANGE, text)
        if abs(roll_deg) > self._settings.max_roll_deg:
            text = f"roll is {roll_deg:.1f} deg, max_roll_deg is {self._settings.max_roll_deg:g}"
            return SensorValue(Quality.OUT_OF_RANGE, text)
        if still:
            return SensorValue(Quality.FROZEN, still)
        if self.noise_deg is None:
            return SensorValue(Quality.STARTING, "too few readings so far")
        if not self._has_moved:
            return SensorValue(Quality.STARTING, "none of its values has changed so far")
        newest_deg = _noise(list(self._rolls_deg)[-_MIN_READINGS:]) or 0.0
        if (noise_deg := max(newest_deg, self.noise_deg)) > self._settings.max_noise_deg:
            text = f"its readings scatter by {noise_deg:.2f} deg"
            return SensorValue(Quality.NOISY, text)
        self.credible.append(Credible(reading.t_ns, tilt, reading.pitch_deg is not None, sensor_deg))
        return SensorValue(
            Quality.GOOD if self._is_at_its_best(reading) else Quality.REDUCED,
            value=roll_deg,
            sigma=math.hypot(tilt.sigma_roll_deg, self.noise_deg),
            t_ns=reading.t_ns,
            expires_ns=reading.t_ns + round(self._settings.max_age_s * 1e9),
            rate=_rate(self._times_ns, self._rolls_deg, math.hypot(self.noise_deg, self._accuracy.step_deg)),
        )

    def mean(self, newest: SensorValue, begin_ns: int, end_ns: int) -> SensorValue:
        """Return the mean roll of the credible readings in this time; of fewer than two, ``newest``."""
        within = [each for each in self.credible if begin_ns <= each.t_ns <= end_ns]
        if newest.value is None or len(within) < _MIN_OF_MEAN or self.noise_deg is None:
            return newest
        away_deg = [within_half_turn(each.tilt.roll_deg - newest.value) for each in within]
        return replace(
            newest,
            value=within_half_turn(newest.value + sum(away_deg) / len(within)),
            sigma=math.hypot(within[-1].tilt.sigma_roll_deg, self.noise_deg / math.sqrt(len(within))),
            t_ns=sum(each.t_ns for each in within) // len(within),
        )

    def mean_pitch_deg(self, begin_ns: int, end_ns: int) -> float:
        """Return the mean pitch of the credible readings in this time; of none, the newest."""
        within = [each for each in self.credible if begin_ns <= each.t_ns <= end_ns] or [self.credible[-1]]
        return sum(each.tilt.pitch_deg for each in within) / len(within)

    def _sensor_deg(self, reading: InclinometerReading) -> float:
        """Return the standard uncertainty of an angle by the sensor's specification, without its zero.

        Limits of error count as a uniform distribution between them, a/√3 (GUM 4.3.7).
        """
        known = self._accuracy
        limit_deg = known.limit_deg if self._is_at_its_best(reading) else known.limit_elsewhere_deg
        zero_c = _STATED_C if self._alignment is None else self._alignment.temperature_c
        drift_deg = known.deg_per_k * (reading.temperature_c - zero_c)
        limits_deg2 = (limit_deg**2 + known.cross_axis_deg**2 + drift_deg**2) / 3
        return math.sqrt(limits_deg2 + known.step_deg**2 / 12)

    def _tilt(self, reading: InclinometerReading, sigma_deg: float) -> Tilt:
        """Return the unit's tilt, with the uncertainties of the sensor (``sigma_deg``) and its zero."""
        settings = self._settings
        roll_deg = settings.sign_roll * reading.roll_deg
        pitch_deg = None if reading.pitch_deg is None else settings.sign_pitch * reading.pitch_deg
        if self._alignment is not None:
            return self._alignment.tilt(roll_deg, pitch_deg, sigma_deg)
        if self._accuracy.roll_is_inclination:
            across = math.sin(math.radians(roll_deg)) / max(math.cos(math.radians(pitch_deg or 0.0)), 1e-9)
            roll_deg = math.degrees(math.asin(min(max(across, -1.0), 1.0)))
        sigma_deg = math.hypot(sigma_deg, settings.offset_sigma_deg)
        return Tilt(
            within_half_turn(roll_deg + settings.offset_roll_deg),
            within_half_turn((pitch_deg or 0.0) + settings.offset_pitch_deg),
            sigma_deg,
            sigma_deg,
        )

    def _stillness(self, reading: InclinometerReading) -> str:
        """Return, as text, which reading did not change for too long; empty: none."""
        last, self._last = self._last, reading
        self._same += 1
        self._has_moved |= last is not None and reading.words != last.words
        if last is None or reading.words != last.words:
            self._moved_ns, self._same = reading.t_ns, 0
        if last is None or reading.roll_deg != last.roll_deg:
            self._roll_moved_ns = reading.t_ns
        still_s = (reading.t_ns - self._moved_ns) * 1e-9
        roll_still_s = (reading.t_ns - self._roll_moved_ns) * 1e-9
        self.longest_still_s = max(self.longest_still_s, still_s)
        if still_s >= self._settings.frozen_after_s and self._same >= _MIN_SAME:
            return f"it has frozen: the same to the last digit for {still_s:.1f} s"
        if roll_still_s >= _MAX_STILL_S:
            return f"its angle has frozen: the same to the last digit for {roll_still_s:.0f} s"
        return ""

    def _is_at_its_best(self, reading: InclinometerReading) -> bool:
        return self._accuracy.from_c <= reading.temperature_c <= self._accuracy.to_c


def _rate(times_ns: Sequence[int], angles_deg: Sequence[float], noise_deg: float) -> float:
    """Return the slope of the angles, degrees/s, 0 if it is not significant (two standard deviations)."""
    since_s = [(t_ns - times_ns[0]) * 1e-9 for t_ns in times_ns]
    middle_s = sum(since_s) / len(since_s)
    spread_s2 = sum((s - middle_s) ** 2 for s in since_s)
    turned_deg = [within_half_turn(angle - angles_deg[0]) for angle in angles_deg]
    moment = sum((s - middle_s) * angle for s, angle in zip(since_s, turned_deg, strict=True))
    return moment / spread_s2 if abs(moment) > _SIGNIFICANT * noise_deg * math.sqrt(spread_s2) > 0.0 else 0.0


def _noise(angles_deg: Sequence[float]) -> float | None:
    """Return the standard deviation of a reading, from second differences: steady rotation is not noise.

    Second differences of independent readings with standard deviation s have standard deviation √6 · s.
    """
    if len(angles_deg) < _MIN_READINGS:
        return None
    steps = [within_half_turn(after - before) for before, after in pairwise(angles_deg)]
    squares = [(after - before) ** 2 for before, after in pairwise(steps)]
    return math.sqrt(sum(squares) / (6 * len(squares)))
