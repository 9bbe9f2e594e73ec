"""The measurements of a second, a minute or an hour as one row."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from altd.history.columns import Column, value_of
from altd.reasons import Signal
from altd.records import Measurement
from altd.status.cause import signal_of
from altd.status.causes import is_warning

WorstFault = tuple[int, str]
"""A severity (0 good to 4 failure) and the code that says why; the larger is the worse."""

GOOD: WorstFault = (Signal.GOOD.severity, "")


@dataclass(slots=True)
class _Sums:
    """Of one quantity, over the measurements that know it."""

    count: int = 0
    total: float = 0.0
    variance_total: float = 0.0
    sigmas: int = 0
    low: float = math.inf
    high: float = -math.inf

    def add(self, value: float, sigma: float | None) -> None:
        self.count += 1
        self.total += value
        self.low, self.high = min(self.low, value), max(self.high, value)
        if sigma is not None:
            self.sigmas += 1
            self.variance_total += sigma * sigma

    def row(self, column: Column) -> tuple[int | None, ...]:
        """Mean, sigma, mean − lowest, highest − mean, in steps."""
        low, high = column.steps(self.low), column.steps(self.high)
        if not self.count or low is None or high is None:
            return None, None, None, None
        mean = min(max(round(self.total / self.count * 10**column.decimals), low), high)
        sigma = math.sqrt(self.variance_total / self.sigmas) if self.sigmas else None
        return mean, column.steps(sigma), mean - low, high - mean


@dataclass(slots=True)
class Summary:
    """The measurements in a span of time, and the worst fault in it.

    The mean is that of the valid measurements, sigma the root of the mean of their variances: what one of
    them is uncertain by, not how they scatter. ``worst`` is of the unit's state, ``lost_to`` of the
    measurements that were not valid.
    """

    columns: Sequence[Column]
    measurements: int = 0
    valid: int = 0
    worst: WorstFault = GOOD
    lost_to: WorstFault = GOOD
    _sums: list[_Sums] = field(init=False)

    def __post_init__(self) -> None:
        self._sums = [_Sums() for _ in self.columns]

    def add(self, measurement: Measurement) -> None:
        """Take a measurement, valid or not."""
        self.measurements += 1
        if measurement.valid:
            self.valid += 1
        else:
            self.lost_to = max(self.lost_to, worst_fault_of(measurement))
        for column, sums in zip(self.columns, self._sums, strict=True):
            known = value_of(measurement, column)
            if known is not None and math.isfinite(known.value):
                sums.add(known.value, known.sigma)

    def note_state(self, fault: WorstFault) -> None:
        """Take the state that the unit showed in this time."""
        self.worst = max(self.worst, fault)

    def numbers(self) -> list[int | None]:
        """Mean, sigma, mean − lowest and highest − mean of each column, in steps."""
        return [
            number
            for column, sums in zip(self.columns, self._sums, strict=True)
            for number in sums.row(column)
        ]


def worst_fault_of(measurement: Measurement) -> WorstFault:
    """The worst of the reasons for which a measurement is invalid."""
    reasons = [fault for fault in measurement.status if not is_warning(fault)]
    return max(
        ((signal_of(fault.reason).severity, str(fault)) for fault in reasons), default=(4, "unknown_reason")
    )
