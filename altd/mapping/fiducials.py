"""The dots of a regular print: they tell how a camera bends the plane, though not where in it they are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from altd.mapping.camera_model import Camera
from altd.mapping.differences import jacobian_px_per_mm
from altd.records import FloatArray

_NEWTON_ITERATIONS = 3
_DIFFERENCE_MM = 0.05


@dataclass(frozen=True, eq=False)
class Fiducials:
    """Places seen at ``px`` (n, 2) whose coordinates on a regular print are ``regular_mm`` (n, 2).

    The regular coordinates are those of the plane but for an affine map, which nobody knows: print lies
    anyhow on its glass. ``sigma_mm`` is the standard deviation of each coordinate.
    """

    px: FloatArray
    regular_mm: FloatArray
    sigma_mm: float

    def misfit(self, camera: Camera) -> tuple[FloatArray, FloatArray]:
        """What no affine map explains of where the camera sees them, and its slopes by the parameters.

        (2 n,) and (2 n, m), both in units of sigma; x of all, then y.
        """
        mm = self.regular_mm
        for _ in range(_NEWTON_ITERATIONS):
            mm = mm + self._unprojected(camera, mm, (self.px - camera.to_px(mm))[:, :, None])[:, :, 0]
        by_parameters = camera.jacobian(mm).reshape(len(mm), 2, -1)
        moves = -self._unprojected(camera, mm, by_parameters)
        bent, slopes = self._without_affine(mm), self._without_affine(moves.reshape(len(mm), -1))
        return (
            bent.T.ravel() / self.sigma_mm,
            slopes.reshape(moves.shape).transpose(1, 0, 2).reshape(2 * len(mm), -1) / self.sigma_mm,
        )

    def _without_affine(self, columns: FloatArray) -> FloatArray:
        """Columns (n, k) without what is affine in the regular coordinates."""
        rest: FloatArray = columns - self._affine @ (self._affine.T @ columns)
        return rest

    @cached_property
    def _affine(self) -> FloatArray:
        """Orthonormal columns (n, 3) that span the affine maps."""
        return np.linalg.qr(np.column_stack([np.ones(len(self.px)), self.regular_mm]))[0]

    @staticmethod
    def _unprojected(camera: Camera, mm: FloatArray, px: FloatArray) -> FloatArray:
        """Small changes (n, 2, k) px at points mm, as changes in mm."""
        return np.asarray(np.linalg.solve(jacobian_px_per_mm(camera.to_px, mm, _DIFFERENCE_MM), px))
