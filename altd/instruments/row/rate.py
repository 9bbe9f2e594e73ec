"""Speed of a place, by a straight line through its displacements of the last day; alarms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.instruments.row.displacement import Displacement
from altd.reasons import Reason
from altd.records import FloatArray

DAY_NS = 86_400 * 10**9
MIN_ALARM_SIGMAS = 4.0
"""Minimum significance of an alarm; reached by chance once in 3000 rounds of a place."""
_MAX_POINTS = 512
_MIN_POINTS = 10
_LASTING_LEVER = 1.5
"""An error step in the middle of a line changes its slope by 1.5 times the step over the line's length."""


@dataclass(frozen=True, slots=True, eq=False)
class DailyRate:
    """Speed (x, y), mm/day, with its standard deviation (2,)."""

    mm_per_day: FloatArray
    sigma: FloatArray

    @property
    def significance(self) -> float:
        """Length of the speed in standard deviations."""
        return float(np.linalg.norm(self.mm_per_day / self.sigma))


class DailyTrend:
    """Displacements of a place in the last day; neighbours are merged when there are too many."""

    def __init__(self) -> None:
        self._points: list[FloatArray] = []
        """Rows of t (days), x, y (mm), their random variances and their lasting variances (mm²)."""

    def add(self, displacement: Displacement) -> DailyRate | None:
        """Add a displacement; return the rate, or None while there are too few."""
        day = displacement.t_ns / DAY_NS
        variances = np.diag(displacement.random_mm2), np.diag(displacement.lasting_mm2)
        self._points = [point for point in self._points if day - point[0] <= 1.0]
        self._points.append(np.concatenate([[day], displacement.mm, *variances]))
        if len(self._points) > _MAX_POINTS:
            self._points = _merged(self._points)
        return self._rate()

    def _rate(self) -> DailyRate | None:
        if len(self._points) < _MIN_POINTS:
            return None
        points = np.array(self._points)
        day, mm, variances = points[:, 0], points[:, 1:3], points[:, 3:5]
        weights = 1.0 / variances
        middle = (weights * day[:, None]).sum(axis=0) / weights.sum(axis=0)
        lever = day[:, None] - middle
        square = (weights * lever**2).sum(axis=0)
        rate = (weights * lever * mm).sum(axis=0) / square
        length = day[-1] - day[0]
        lasting_mm = np.sqrt(points[:, 5:7].mean(axis=0))
        sigma = np.hypot(1.0 / np.sqrt(square), _LASTING_LEVER * lasting_mm / length)
        return DailyRate(rate, sigma)


def _merged(points: Sequence[FloatArray]) -> list[FloatArray]:
    """Merge pairs of neighbours in the older half into their means; the newer half is kept."""
    half = len(points) // 4 * 2
    merged = []
    for first, second in zip(points[0:half:2], points[1:half:2], strict=True):
        mean = (first + second) / 2.0
        mean[3:5] /= 2.0
        merged.append(mean)
    return [*merged, *points[half:]]


def alarms(
    displacement: Displacement, rate: DailyRate | None, alarm_mm: float | None, alarm_mm_per_day: float | None
) -> tuple[Reason, ...]:
    """``alarm_displacement`` and ``alarm_rate`` where a limit is reached with sufficient significance."""
    raised = list[Reason]()
    far = alarm_mm is not None and math.hypot(*displacement.mm.tolist()) >= alarm_mm
    if far and displacement.significance >= MIN_ALARM_SIGMAS:
        raised.append(Reason.ALARM_DISPLACEMENT)
    if rate is not None and alarm_mm_per_day is not None:
        fast = math.hypot(*rate.mm_per_day.tolist()) >= alarm_mm_per_day
        if fast and rate.significance >= MIN_ALARM_SIGMAS:
            raised.append(Reason.ALARM_RATE)
    return tuple(raised)
