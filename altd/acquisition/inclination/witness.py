"""Gravity as a witness of the beam: its inclination by beam and inclinometer against the known one. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from altd.acquisition.inclination.alignment import vertical
from altd.records import Value

REFERENCE_S = 600.0
"""Time over which the first reference is learnt: shorter changes are vibration."""
MAX_GAP_S = 600.0
"""Maximum gap between two samples; after a longer one, perhaps with another laser, the reference is new."""
INTERVAL_S = 1.0
"""Minimum time between two samples: that of the means of a beam."""
_NOW_S = 5.0
"""Time whose samples are compared, so that a jump is reported within 10 s."""
_RECENT_S = 300.0
"""Time before that with which they are compared for a jump."""
_MIN_NOW, _MIN_RECENT = 3, 60
_MAP_DEG = 0.003
"""Standard uncertainty of a direction by the maps without a flat, at two places of the targets each."""
_ALIKE_DEG = 1.0
"""Change of roll or pitch from which errors of the sensor, within its limits, count as independent."""


@dataclass(frozen=True, slots=True)
class Inclination:
    """The beam's inclination against gravity, degrees, positive if it rises.

    ``sigma_deg`` is its combined standard uncertainty, ``beam_deg`` and ``sensor_deg`` the parts by beam and
    inclinometer that may differ between two places and times, without the errors of their zeros.
    ``tilt_deg`` is the unit's roll and pitch.
    """

    t_ns: int
    value_deg: float
    sigma_deg: float
    beam_deg: float
    sensor_deg: float
    tilt_deg: tuple[float, float]


def inclination(
    t_ns: int, slopes: tuple[float, float], beam: Value, unit: tuple[Value, Value], sensor_deg: float
) -> Inclination:
    """Return the inclination of a beam with slopes (sx, sy) in a ``unit`` with this roll and pitch, degrees.

    sin(inclination) = d · u, with d along the beam and the vertical u, both of length 1: with roll the
    beam's yaw contributes. ``beam`` is its pitch, of which the sigmas count; ``sensor_deg`` is the standard
    uncertainty of the sensor without its zero.
    """
    roll, pitch = unit
    along = np.array([*slopes, 1.0]) / math.hypot(*slopes, 1.0)
    value_deg = math.degrees(math.asin(float(along @ vertical(roll.value, pitch.value))))
    random_deg = beam.sigma_random or beam.sigma or 0.0
    return Inclination(
        t_ns,
        value_deg,
        math.hypot(beam.sigma or 0.0, pitch.sigma or 0.0, slopes[0] * (roll.sigma or 0.0)),
        math.hypot(random_deg, _MAP_DEG),
        math.hypot(1.0, slopes[0]) * sensor_deg,
        (roll.value, pitch.value),
    )


@dataclass(frozen=True, slots=True)
class _Mean:
    """Mean of samples; ``scatter_deg`` is the standard deviation of one: a swing is in all of them."""

    value_deg: float
    scatter_deg: float
    newest: Inclination

    @classmethod
    def of(cls, samples: Sequence[Inclination]) -> _Mean:
        values_deg = np.array([sample.value_deg for sample in samples])
        return cls(float(values_deg.mean()), float(values_deg.std(ddof=1)), samples[-1])

    def since(self, before: _Mean) -> Value:
        """Return the change since an earlier mean, degrees, with its combined standard uncertainty."""
        tilted_deg = math.dist(self.newest.tilt_deg, before.newest.tilt_deg)
        sensor_deg = math.hypot(self.newest.sensor_deg, before.newest.sensor_deg)
        sensor_deg *= min(tilted_deg / _ALIKE_DEG, 1.0)
        beam_deg = math.hypot(self.newest.beam_deg, before.newest.beam_deg)
        return Value(self.value_deg - before.value_deg, math.hypot(sensor_deg, beam_deg, self.scatter_deg))


class Witness:
    """Compares the last seconds with the ``stated`` inclination, degrees, or with the first ten minutes.

    In both cases it compares them with the five minutes before, too: a jump shows against them best, a slow
    change against the others. After a jump of more than ``sigmas`` uncertainties these five minutes remain
    the reference until the beam is back: otherwise it would count as usual after five minutes.
    """

    def __init__(self, sigmas: float, stated: Value | None = None) -> None:
        self._sigmas = sigmas
        self._stated = stated
        self._before_jump: _Mean | None = None
        self._samples: deque[Inclination] = deque(maxlen=round((_RECENT_S + 2 * _NOW_S) / INTERVAL_S))
        self._first: list[Inclination] = []
        self._reference: _Mean | None = None

    def add(self, sample: Inclination) -> None:
        """Add the inclination of a measurement; one a second counts."""
        since_s = (sample.t_ns - self._samples[-1].t_ns) * 1e-9 if self._samples else 0.0
        if self._samples and since_s < INTERVAL_S:
            return
        if since_s > MAX_GAP_S:
            self._samples.clear()
            self._first, self._reference, self._before_jump = [], None, None
        self._samples.append(sample)
        latest, before = self._latest(sample.t_ns), self._before_jump or self._recent(sample.t_ns)
        has_jumped = latest is not None and before is not None and self.is_away(latest.since(before))
        if self._before_jump is not None and not has_jumped:  # it is back: the time away is no reference
            self._samples = deque([sample], self._samples.maxlen)
        self._before_jump = before if has_jumped else None
        if self._stated is None and self._reference is None and not has_jumped:
            self._first.append(sample)
            if (sample.t_ns - self._first[0].t_ns) * 1e-9 >= REFERENCE_S:
                self._first, self._reference = [], _Mean.of(self._first)

    def is_away(self, difference: Value) -> bool:
        """Return whether a difference is more than ``sigmas`` of its uncertainties."""
        return abs(difference.value) > self._sigmas * (difference.sigma or 0.0)

    def difference(self, now_ns: int) -> Value | None:
        """Return the inclination now minus the known one, degrees, with its combined standard uncertainty.

        Of several known ones, that which differs most in these uncertainties. None: not known yet, or the
        last samples are too old.
        """
        return max(
            self._differences(now_ns), key=lambda value: abs(value.value) / (value.sigma or 1.0), default=None
        )

    def _differences(self, now_ns: int) -> Iterator[Value]:
        now = self._latest(now_ns)
        if now is None:
            return
        if self._stated is not None:
            sigma_deg = math.hypot(now.newest.sigma_deg, self._stated.sigma or 0.0, now.scatter_deg)
            yield Value(now.value_deg - self._stated.value, sigma_deg)
        for before in (self._reference, self._before_jump or self._recent(now_ns)):
            if before is not None:
                yield now.since(before)

    def _latest(self, now_ns: int) -> _Mean | None:
        """Return the mean of the last seconds; None: too few samples."""
        begin_ns = now_ns - round((_NOW_S + INTERVAL_S) * 1e9)
        latest = [sample for sample in self._samples if sample.t_ns > begin_ns]
        return _Mean.of(latest) if len(latest) >= _MIN_NOW else None

    def _recent(self, now_ns: int) -> _Mean | None:
        """Return the mean of the five minutes before them; None: too few samples."""
        end_ns = now_ns - round((2 * _NOW_S + INTERVAL_S) * 1e9)
        recent = [s for s in self._samples if end_ns - _RECENT_S * 1e9 < s.t_ns <= end_ns]
        return _Mean.of(recent) if len(recent) >= _MIN_RECENT else None
