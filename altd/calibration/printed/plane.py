"""Where on the target each pixel looks, quickly."""

from __future__ import annotations

import numpy as np

from altd.mapping.tensor_map import TensorMap
from altd.records import FloatArray

_MARGIN_MM = 8.0
_POINTS_ACROSS = 50
_DEGREE = 8


class Plane:
    """The inverse of a map as one polynomial, quick for many pixels.

    Good to nanometres over the nodes' rectangle and a margin of 8 mm around, where spots at the outer nodes
    reach.
    """

    def __init__(self, fitted: TensorMap) -> None:
        x, y = (
            np.linspace(axis.first_mm - _MARGIN_MM, axis.last_mm + _MARGIN_MM, _POINTS_ACROSS)
            for axis in (fitted.x_axis, fitted.y_axis)
        )
        mm = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        px = fitted.to_px(mm)
        self._middle = px.mean(axis=0)
        self._scale = float(np.abs(px - self._middle).max())
        u, v = self._powers(px[:, 0], 0), self._powers(px[:, 1], 1)
        i, j = np.nonzero(np.add.outer(np.arange(_DEGREE + 1), np.arange(_DEGREE + 1)) <= _DEGREE)
        self._coefficients = np.zeros((2, _DEGREE + 1, _DEGREE + 1))
        self._coefficients[:, i, j] = np.linalg.lstsq(u[:, i] * v[:, j], mm, rcond=None)[0].T

    def to_mm(self, px: FloatArray) -> FloatArray:
        """Points (n, 2) px as (n, 2) mm."""
        u, v = self._powers(px[:, 0], 0), self._powers(px[:, 1], 1)
        return np.stack([((u @ coefficients) * v).sum(axis=1) for coefficients in self._coefficients], axis=1)

    def grid_mm(self, rows: int, columns: int) -> FloatArray:
        """All pixels of a picture as (rows, columns, 2) mm."""
        u = self._powers(np.arange(columns, dtype=np.float64), 0)
        v = self._powers(np.arange(rows, dtype=np.float64), 1)
        return np.stack([v @ coefficients.T @ u.T for coefficients in self._coefficients], axis=-1)

    def metric(self, px: FloatArray) -> FloatArray:
        """J Jᵀ (2, 2) in mm²/px² at a point (2,) px, with J = d(mm)/d(px)."""
        ends = self.to_mm(px + 0.5 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]))
        jacobian = np.column_stack([ends[0] - ends[1], ends[2] - ends[3]])
        return np.asarray(jacobian @ jacobian.T)

    def _powers(self, px: FloatArray, axis: int) -> FloatArray:
        return np.vander((px - self._middle[axis]) / self._scale, _DEGREE + 1, increasing=True)
