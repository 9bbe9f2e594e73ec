"""Camera that views a plane: pinhole with Brown's distortion, or Kannala and Brandt's fisheye.

Also the shift of a patch of light: its centre in the picture against the picture of its centre.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from altd.mapping.grid import Axis
from altd.mapping.tensor_map import tensor_basis
from altd.records import FloatArray

ToPx = Callable[[FloatArray], FloatArray]
"""Points (n, 2) mm to (n, 2) px."""


def jacobian_px_per_mm(to_px: ToPx, points_mm: FloatArray, step_mm: float) -> FloatArray:
    """Return d(u, v)/d(x, y) of a map at points (n, 2), as (n, 2, 2), from ``step_mm`` to either side."""
    ahead_x, behind_x, ahead_y, behind_y = to_px_about(to_px, points_mm, step_mm * _SIDES)
    return np.stack([ahead_x - behind_x, ahead_y - behind_y], axis=-1) / (2 * step_mm)


_SIDES = np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])


def to_px_about(to_px: ToPx, points_mm: FloatArray, offsets_mm: FloatArray) -> FloatArray:
    """Map points (n, 2) moved by each of ``offsets_mm`` (k, 2), as (k, n, 2), in one call."""
    moved = points_mm[None] + offsets_mm[:, None]
    return to_px(moved.reshape(-1, 2)).reshape(moved.shape)


Optics = Literal["brown", "fisheye"]
OPTICS: tuple[Optics, ...] = get_args(Optics)

_USUAL_FOCAL_WIDTHS = 1.4
"""Usual focal length in image widths; the nodes of one plane hardly distinguish it from the distance."""

_POSE_PRIOR = [np.inf] * 6 + [0.5, 0.03, 0.03]
_POSE_DIFFERENCES = [1e-5, 1e-5, 1e-5, 1e-3, 1e-3, 1e-5, 1e-3, 1e-4, 1e-4]

_PRIOR = {
    "brown": np.array([*_POSE_PRIOR, 0.5, 0.2, 0.0005, 0.0005]),
    "fisheye": np.array([*_POSE_PRIOR, 0.5, 0.2]),
}
"""Standard deviations of the parameters' priors, in their own units: see ``CameraModel``. Wide compared with
the variety of lenses, and tight enough to determine what 30 nodes can hardly separate: tilt, principal point
and decentring."""

_DIFFERENCES = {
    "brown": np.array([*_POSE_DIFFERENCES, 1e-4, 1e-4, 1e-6, 1e-6]),
    "fisheye": np.array([*_POSE_DIFFERENCES, 1e-4, 1e-4]),
}

_BEND_PRIOR_PX = 0.2
"""Assumed deviation of a lens from its model, as the rms that one term of the bend adds."""


@dataclass(frozen=True, slots=True)
class Bend:
    """Tensor polynomial in mm on Gram polynomials, added to the projection by the lens model.

    Without its constant and linear terms, which the camera's pose already includes.
    """

    x_axis: Axis
    y_axis: Axis
    degree: int

    @property
    def terms(self) -> int:
        """Number of coefficients of one coordinate."""
        return (self.degree + 1) ** 2 - 3

    def basis(self, points_mm: FloatArray) -> FloatArray:
        """Return the terms at points (n, 2), as (n, terms)."""
        size = self.degree + 1
        bending = [i * size + j for i in range(size) for j in range(size) if i + j > 1]
        return tensor_basis((self.x_axis, self.y_axis), (self.degree, self.degree), points_mm)[:, bending]


@dataclass(frozen=True, slots=True, eq=False)
class CameraModel:
    """Camera that views a plane.

    ``parameters`` (m,): rotation vector; offset of the axis from the plane's origin (x, y) mm; log of the
    scale px/mm; log of the focal length over its usual value; principal point's offset from the image's
    middle in image widths (u, v); then the optics': Brown's k1, k2, p1, p2, or the fisheye's k1, k2 as OpenCV
    numbers them; then those of the bend, u before v, px. ``mirrored``: seen from behind.
    """

    optics: Optics
    parameters: FloatArray
    mirrored: bool
    width: int
    height: int
    bend: Bend | None = None

    @staticmethod
    def optical_parameters(optics: Optics) -> int:
        """Return the number of parameters of pose and optics."""
        return len(_PRIOR[optics])

    @property
    def prior(self) -> FloatArray:
        """Standard deviations (m,) of the parameters' priors; infinite where nothing is known."""
        if self.bend is None:
            return _PRIOR[self.optics]
        nodes = self.bend.x_axis.nodes * self.bend.y_axis.nodes
        return np.concatenate(
            [_PRIOR[self.optics], np.full(2 * self.bend.terms, _BEND_PRIOR_PX * math.sqrt(nodes))]
        )

    def with_bend(self, bend: Bend) -> CameraModel:
        """Return the same camera with a bend of 0."""
        return replace(
            self, parameters=np.concatenate([self.parameters, np.zeros(2 * bend.terms)]), bend=bend
        )

    def to_px(self, points_mm: FloatArray) -> FloatArray:
        """Project points (n, 2) mm of the plane to (n, 2) px."""
        optical = len(_PRIOR[self.optics])
        px: FloatArray = self._project(self.parameters[None, :optical], points_mm)[0]
        if self.bend is not None:
            coefficients = self.parameters[optical:].reshape(2, -1)
            px = px + self.bend.basis(points_mm) @ coefficients.T
        return px

    def jacobian(self, points_mm: FloatArray) -> FloatArray:
        """Return d(px)/d(parameters) as (2 n, m), by central differences; rows u, v point by point."""
        steps = _DIFFERENCES[self.optics]
        at = self.parameters[: len(steps)]
        shifted = np.concatenate([at + np.diag(steps), at - np.diag(steps)])
        px = self._project(shifted, points_mm).reshape(2, len(steps), -1)
        slopes: FloatArray = ((px[0] - px[1]) / (2 * steps[:, None])).T
        if self.bend is None:
            return slopes
        basis = self.bend.basis(points_mm)
        return np.hstack([slopes, np.einsum("nk,cd->ncdk", basis, np.eye(2)).reshape(len(slopes), -1)])

    def _project(self, p: FloatArray, points_mm: FloatArray) -> FloatArray:
        """Project points (n, 2) with each of k rows of parameters, as (k, n, 2)."""
        focal_px = _USUAL_FOCAL_WIDTHS * self.width * np.exp(p[:, 6])
        side = -1.0 if self.mirrored else 1.0
        turned = np.einsum("kij,nj->ikn", _rotations(p[:, :3])[:, :, :2], points_mm * (side, -1.0))
        z = turned[2] + (focal_px / np.exp(p[:, 5]))[:, None]
        x, y = (turned[0] + p[:, 3:4]) / z, (turned[1] + p[:, 4:5]) / z
        u, v = _brown(x, y, p[:, 9:]) if self.optics == "brown" else _fisheye(x, y, p[:, 9:])
        middle = np.array([(self.width - 1) / 2, (self.height - 1) / 2]) + self.width * p[:, 7:9]
        return np.stack([u, v], axis=-1) * focal_px[:, None, None] + middle[:, None, :]


def _brown(x: FloatArray, y: FloatArray, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return slopes (k, n) bent by radial k1, k2 and decentring p1, p2."""
    k1, k2, p1, p2 = k.T[:, :, None]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * k2)
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def _fisheye(x: FloatArray, y: FloatArray, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return slopes (k, n) bent so that the middle's distance follows the angle, θ + k1 θ³ + k2 θ⁵."""
    k1, k2 = k.T[:, :, None]
    slope = np.maximum(np.hypot(x, y), 1e-12)
    angle = np.arctan(slope)
    square = angle * angle
    scale = angle * (1 + square * (k1 + square * k2)) / slope
    return x * scale, y * scale


def _rotations(vectors: FloatArray) -> FloatArray:
    """Apply Rodrigues' formula to rotation vectors (k, 3), as (k, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.maximum(angle, 1e-12)[:, None]).T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    sine, versine = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
    rotations: FloatArray = np.eye(3) + sine * cross + versine * cross @ cross
    return rotations


_DELTA_MM = 0.5
"""Step of all derivatives: second ones need one this long, and first ones use it too."""
_STEPS = np.arange(-2.0, 3.0)


def px2_per_mm2(to_px: ToPx, points_mm: FloatArray) -> FloatArray:
    """Return by how much a map enlarges areas at points (n, 2), (n,)."""
    return np.asarray(np.abs(np.linalg.det(jacobian_px_per_mm(to_px, points_mm, _DELTA_MM))))


def light_centre_shift_px(to_px: ToPx, points_mm: FloatArray, moment_mm2: float) -> FloatArray:
    """Return the shift, (n, 2) px, of the centre of light of patches about points (n, 2) mm: centre − P(c).

    An even disc of radius R about c is seen through a smooth map P (mm → px) with the Jacobian J. Its picture
    is evenly bright, so its centre of area is ∫ P |J| dA / ∫ |J| dA. With P(c + d) = P + J d + ½ dᵀ P″ d + …,
    |J(c + d)| = |J| (1 + g·d + …), g = ∇ ln |J|, and the disc's second moment ⟨d dᵀ⟩ = m I, m = R²/4, the
    terms of second order are

        centre − P(c) = m (½ ∇²P + J g) + O(R⁴).

    For a pinhole this is the known bias of a circle's centre under perspective (J. Heikkilä, O. Silvén, "A
    four-step camera calibration procedure with implicit image correction", CVPR 1997); written with the map's
    own derivatives it holds for any lens. The shift of a round laser spot is the same, with the second moment
    of the weights that its localiser uses.
    """
    # [i, j]: the map (n, 2) at i, j steps along x, y
    grid = np.stack(np.meshgrid(_STEPS, _STEPS, indexing="ij"), axis=-1).reshape(-1, 2)
    px = to_px_about(to_px, points_mm, _DELTA_MM * grid).reshape(5, 5, -1, 2)
    slopes = np.stack([px[2:, 1:-1] - px[:-2, 1:-1], px[1:-1, 2:] - px[1:-1, :-2]], axis=-1) / (2 * _DELTA_MM)
    log_area = np.log(np.abs(np.linalg.det(slopes)))  # [i, j], one step to either side
    laplacian = (px[3, 2] + px[1, 2] + px[2, 3] + px[2, 1] - 4 * px[2, 2]) / _DELTA_MM**2
    log_gradient = np.stack([log_area[2, 1] - log_area[0, 1], log_area[1, 2] - log_area[1, 0]], axis=-1)
    tilt = np.einsum("nij,nj->ni", slopes[1, 1], log_gradient / (2 * _DELTA_MM))
    return np.asarray(moment_mm2 * (laplacian / 2 + tilt))


def disc_moment_mm2(diameter_mm: float) -> float:
    """Return the second moment along one axis of an even disc."""
    return diameter_mm**2 / 16


def spot_moment_mm2(diameter_mm: float, threshold: float, power: float) -> float:
    """Return the second moment along one axis of weights (I − T)₊^p of a Gaussian spot of that 1/e² diameter.

    With s = r², I = exp(−8 s/D²), the moment is ½ ∫ s w ds / ∫ w ds, by the midpoint rule.
    """
    steps = 2000
    s = (np.arange(steps) + 0.5) / steps * np.log(1 / max(threshold, 1e-3))  # in units of D²/8
    weight = np.maximum(np.exp(-s) - threshold, 0) ** power
    return float(diameter_mm**2 / 16 * (s @ weight) / weight.sum())
