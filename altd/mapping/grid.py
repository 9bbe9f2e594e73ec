"""The grid of known points, mm, on which a map is fitted and inside which it is valid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from altd.records import FloatArray

_SAME_MM = 1e-3
_UNEVEN_STEPS = 0.1


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
        """The axis through positions that lie near equidistant nodes, as a stage reports them.

        Positions closer together than a third of the widest gap count as one node; the nodes' means may
        lie off equal steps by a tenth of a step, since the fit uses the positions themselves. Raises
        ValueError when there are fewer than two nodes or the steps differ by more.
        """
        ordered = np.sort(mm)
        gaps = np.diff(ordered)
        if not len(gaps) or gaps.max() <= _SAME_MM:
            raise ValueError("all nodes have the same position")
        nodes = np.array(
            [part.mean() for part in np.split(ordered, np.flatnonzero(gaps > gaps.max() / 3) + 1)]
        )
        step = float(nodes[-1] - nodes[0]) / (len(nodes) - 1)
        off = nodes - (nodes[0] + step * np.arange(len(nodes)))
        if np.abs(off).max() > _UNEVEN_STEPS * step:
            steps = np.diff(nodes)
            raise ValueError(f"steps from {steps.min():.3f} to {steps.max():.3f} mm are not equal")
        return cls(float(nodes[0]), step, len(nodes))
