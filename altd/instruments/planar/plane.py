"""Camera of a plane: homography or lens, mm of the plane ↔ px of the picture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from altd.instruments.planar.homography import apply_homography, with_slopes
from altd.mapping.camera_model import CameraModel, jacobian_px_per_mm
from altd.mapping.lens import fit_camera
from altd.mapping.nodes import Nodes
from altd.records import FloatArray

Model = Literal["homography", "lens"]
MODELS: tuple[Model, ...] = get_args(Model)

STEP_MM = 0.5
"""Step of numerical derivatives by position on the plane."""
_NEWTON_STEPS = 12
_NEGLIGIBLE_MM = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class PlaneCamera:
    """Places (n, 2) mm of the plane ↔ (n, 2) px, through a homography or a lens with Brown's distortion.

    Both are relative to ``origin_mm``. ``parameters`` of the homography are h1 … h8 of mm → px with h9 = 1,
    those of the lens are ``CameraModel.parameters``.
    """

    model: Model
    parameters: FloatArray
    origin_mm: FloatArray
    width: int
    height: int

    @property
    def precision(self) -> FloatArray:
        """Prior precision of the parameters, (p,): 1/σ², 0 without prior knowledge."""
        if self.model == "homography":
            return np.zeros(len(self.parameters))
        precision: FloatArray = 1.0 / np.square(self._camera.prior)
        return precision

    def moved_by(self, step: FloatArray) -> PlaneCamera:
        """Copy with ``step`` added to the parameters."""
        return replace(self, parameters=self.parameters + step)

    def to_px(self, points_mm: FloatArray) -> FloatArray:
        """Image points (n, 2) px of places (n, 2) mm."""
        from_origin = points_mm - self.origin_mm
        if self.model == "lens":
            return self._camera.to_px(from_origin)
        return apply_homography(self._homography, from_origin)

    def jacobian(self, points_mm: FloatArray) -> FloatArray:
        """Jacobian d(u, v)/d(parameters), (n, 2, p)."""
        from_origin = points_mm - self.origin_mm
        if self.model == "lens":
            slopes = self._camera.jacobian(from_origin)
        else:
            slopes = with_slopes(self._homography, from_origin)[1]
        return slopes.reshape(len(points_mm), 2, -1)

    def px_per_mm(self, points_mm: FloatArray) -> FloatArray:
        """Jacobian d(u, v)/d(x, y), (n, 2, 2)."""
        return jacobian_px_per_mm(self.to_px, points_mm, STEP_MM)

    def to_mm(self, points_px: FloatArray) -> FloatArray:
        """Places (n, 2) mm of image points (n, 2) px, by Newton's method; NaN where it fails."""
        points_mm = np.repeat(self.origin_mm[None, :], len(points_px), axis=0)
        with np.errstate(all="ignore"):
            for _ in range(_NEWTON_STEPS):
                miss = points_px - self.to_px(points_mm)
                determinant = np.linalg.det(slopes := self.px_per_mm(points_mm))
                slopes[~(np.abs(determinant) > 1e-9)] = np.nan
                step = np.linalg.solve(slopes, miss[:, :, None])[:, :, 0]
                points_mm = points_mm + step
                if not np.any(np.abs(step) > _NEGLIGIBLE_MM):
                    break
            off_px = np.linalg.norm(points_px - self.to_px(points_mm), axis=1)
        return np.where((off_px < 1e-3)[:, None], points_mm, np.nan)

    @property
    def _camera(self) -> CameraModel:
        return CameraModel("brown", self.parameters, False, self.width, self.height)

    @property
    def _homography(self) -> FloatArray:
        return np.append(self.parameters, 1.0).reshape(3, 3)


def homography_camera(
    mm_per_px: FloatArray, points_mm: FloatArray, image_size: tuple[int, int]
) -> PlaneCamera:
    """Camera of a homography (3, 3) px → mm; its origin is the mean of ``points_mm`` (n, 2)."""
    origin = points_mm.mean(axis=0)
    from_origin = np.array([[1.0, 0.0, origin[0]], [0.0, 1.0, origin[1]], [0.0, 0.0, 1.0]])
    px_per_mm = np.linalg.inv(mm_per_px) @ from_origin
    return PlaneCamera("homography", (px_per_mm / px_per_mm[2, 2]).ravel()[:8], origin, *image_size)


def lens_camera(points_mm: FloatArray, points_px: FloatArray, image_size: tuple[int, int]) -> PlaneCamera:
    """Fit a lens to places (n, 2) mm and their image points (n, 2) px; raises ValueError for too few."""
    origin = points_mm.mean(axis=0)
    camera = fit_camera(Nodes.ordinary(points_mm - origin, points_px), image_size)
    return PlaneCamera("lens", camera.parameters, origin, *image_size)
