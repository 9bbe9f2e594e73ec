"""The grid of known points, mm, on which a map is fitted and inside which it is valid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from altd.records import FloatArray

_SAME_MM = 1e-3


@dataclass(frozen=True, slots=True)
class Axis:
    """Equidistant positions along one axis, mm."""

    first_mm: float
    step_mm: float
    nodes: int

    @property
    def last_mm(self) -> float:
        """The largest position."""
        return self.first_mm + self.step_mm * (self.nodes - 1)

    @property
    def unit_per_mm(self) -> float:
        """d(unit)/d(mm) of ``to_unit``."""
        return 2 / (self.nodes * self.step_mm)

    def to_unit(self, mm: FloatArray) -> FloatArray:
        """Positions in the units of the Gram basis (Eq. 3.22)."""
        return (mm - self.first_mm) * self.unit_per_mm - 1 + 1 / self.nodes

    @classmethod
    def through(cls, mm: FloatArray) -> Self:
        """The axis through scattered positions that lie on equidistant nodes.

        Raises ValueError when there are fewer than two nodes or the steps differ by more than 1 µm.
        """
        levels = np.unique(np.round(mm / _SAME_MM)) * _SAME_MM
        if len(levels) < 2:
            raise ValueError("all nodes have the same position")
        steps = np.diff(levels)
        if steps.max() - steps.min() > 2 * _SAME_MM:
            raise ValueError(f"steps from {steps.min():.3f} to {steps.max():.3f} mm are not equidistant")
        return cls(float(levels[0]), float((levels[-1] - levels[0]) / (len(levels) - 1)), len(levels))
