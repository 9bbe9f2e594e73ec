"""Second, independent map of a target that checks every measured point (thesis A.4)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from altd.mapping.polynomials import Rows, horner, rows
from altd.mapping.tensor_map import Fit, TensorMap

_LIMIT_SIGMAS = 3.0
"""Limit per difference expected from leave-one-out residuals. On 320 simulated lenses (f = 3.6 to 12 mm, 6 ×
5 and 7 × 5 nodes) the largest difference of the maps was 0.8 of the expected, 1.5 in the worst case."""


@dataclass(frozen=True)
class CrossCheck:
    """Map of the other model family, and the limit of its difference from the checked map.

    ``leave_one_out_px`` is the rms of this map's leave-one-out residuals, ``limit_px`` the distance in the
    image above which a point is implausible, and ``max_difference_px`` the largest distance over the hull
    when both maps were made.
    """

    map: TensorMap
    leave_one_out_px: float
    limit_px: float
    max_difference_px: float

    @classmethod
    def between(cls, fit: Fit, other: Fit) -> Self:
        """Return the check of one fit by another.

        The error of either map at a place without a node is about its leave-one-out rms, model error and
        noise together. Two correct maps thus differ by about the root of the sum of both squares, mostly by
        less: leaving out a node widens the gap between nodes. The limit is three times that.
        """
        dense_mm = fit.map.dense_mm()
        difference_px = np.linalg.norm(other.map.to_px(dense_mm) - fit.map.to_px(dense_mm), axis=1)
        return cls(
            map=other.map,
            leave_one_out_px=other.leave_one_out_px,
            limit_px=_LIMIT_SIGMAS * math.hypot(fit.leave_one_out_px, other.leave_one_out_px),
            max_difference_px=float(difference_px.max()),
        )

    def limit_at_px(self, checked: TensorMap, outside_mm: float) -> float:
        """Return the limit at a place ``outside_mm`` outside the hull, where both maps are less certain."""
        beyond_px = max(outside_mm, 0.0) * math.hypot(checked.beyond_px_per_mm, self.map.beyond_px_per_mm)
        return math.hypot(self.limit_px, _LIMIT_SIGMAS * beyond_px)

    def difference_px(self, x_mm: float, y_mm: float, u_px: float, v_px: float) -> tuple[float, float]:
        """Return (u, v) minus this map's image of (x, y), the point by the checked map, px."""
        u, v, (middle_x, middle_y), (per_x, per_y) = self._plain
        q, r = (x_mm - middle_x) * per_x, (y_mm - middle_y) * per_y
        return u_px - horner(u, q, r), v_px - horner(v, q, r)

    @cached_property
    def _plain(self) -> tuple[Rows, Rows, tuple[float, float], tuple[float, float]]:
        u, v, _ = self.map.powers()
        axes = self.map.x_axis, self.map.y_axis
        middle_x, middle_y = ((axis.first_mm + axis.last_mm) / 2 for axis in axes)
        return rows(u), rows(v), (middle_x, middle_y), (axes[0].unit_per_mm, axes[1].unit_per_mm)
