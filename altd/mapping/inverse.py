"""px → mm: Newton's method on the tensor map from a direct polynomial start (DESIGN §7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from altd.mapping.hull import distance_outside_mm
from altd.mapping.tensor_map import TensorMap
from altd.records import FloatArray

_START_DEGREE = 3
_MAX_STEPS = 12
_CONVERGED_PX = 1e-6
_HULL_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class InverseMap:
    """The inverse of a tensor map, with its start: a polynomial x(u, v), y(u, v) of total degree 3."""

    forward: TensorMap
    _start: FloatArray
    _centre_px: FloatArray
    _scale_px: float

    @classmethod
    def of(cls, forward: TensorMap) -> Self:
        """Prepare the inverse: the start is fitted to a dense grid over the map's own grid."""
        x = np.linspace(forward.x_axis.first_mm, forward.x_axis.last_mm, 4 * forward.x_axis.nodes)
        y = np.linspace(forward.y_axis.first_mm, forward.y_axis.last_mm, 4 * forward.y_axis.nodes)
        points_mm = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        px = forward.to_px(points_mm)
        centre = px.mean(axis=0)
        scale = float(np.abs(px - centre).max())
        start = np.linalg.lstsq(_monomials((px - centre) / scale), points_mm, rcond=None)[0]
        return cls(forward, np.asarray(start), np.asarray(centre), scale)

    def to_mm(self, points_px: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Map points (n, 2) px to (n, 2) mm.

        Returns the points, d(x, y)/d(u, v) as (n, 2, 2) mm/px, and the covariance (n, 2, 2) mm² that the
        map's own noise leaves: what a single place scatters about the map (print and speckle are fixed
        patterns, so no averaging removes it) and what the map itself is uncertain by. A point for which
        Newton does not converge, or that lies outside the hull by more than three of its sigmas, is NaN.
        """
        guess = _monomials((points_px - self._centre_px) / self._scale_px) @ self._start
        span = np.array(
            [
                self.forward.x_axis.last_mm - self.forward.x_axis.first_mm,
                self.forward.y_axis.last_mm - self.forward.y_axis.first_mm,
            ]
        )
        converged = np.zeros(len(points_px), bool)
        inverse_jacobian = np.full((len(points_px), 2, 2), np.nan)
        for _ in range(_MAX_STEPS):
            px, jacobian = self.forward.to_px_with_jacobian(guess)
            inverse_jacobian = _inverse_2x2(jacobian)
            miss = points_px - px
            converged = np.abs(miss).max(axis=1) < _CONVERGED_PX
            if converged.all():
                break
            step = np.einsum("nij,nj->ni", inverse_jacobian, miss)
            guess = guess + np.clip(np.nan_to_num(step), -span / 4, span / 4)
        variance = self.forward.pattern_px**2 + self.forward.variance_px2(guess)
        covariance = np.einsum("nij,n,nkj->nik", inverse_jacobian, variance, inverse_jacobian)
        sigma_mm = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
        outside = distance_outside_mm(guess, self.forward.hull_mm) > _HULL_SIGMAS * sigma_mm
        lost = ~converged | outside | ~np.isfinite(sigma_mm)
        return np.where(lost[:, None], np.nan, guess), inverse_jacobian, covariance


def _monomials(q: FloatArray) -> FloatArray:
    """All monomials up to the start's total degree of points (n, 2)."""
    u, v = q[:, 0], q[:, 1]
    return np.stack(
        [u**i * v**j for i in range(_START_DEGREE + 1) for j in range(_START_DEGREE + 1 - i)], axis=-1
    )


def _inverse_2x2(matrix: FloatArray) -> FloatArray:
    """Inverses (n, 2, 2); a singular one becomes NaN."""
    a, b, c, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 0], matrix[:, 1, 1]
    determinant = a * d - b * c
    determinant = np.where(np.abs(determinant) < 1e-12, np.nan, determinant)
    return np.stack([d, -b, -c, a], axis=-1).reshape(-1, 2, 2) / determinant[:, None, None]
