"""A lens model as a map: pinhole with Brown distortion, fitted to the nodes and kept as a tensor polynomial.

It has 13 parameters for both coordinates where the plain tensor polynomial has 40, so the nodes' noise leaves
less in it, as long as the lens is one that the model describes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from altd.mapping.gram import gram_basis
from altd.mapping.grid import Axis
from altd.mapping.tensor_map import Fit, TensorMap
from altd.records import FloatArray

_FIRST_NOISE_PX = 0.05
_ROUNDS = 3
_MAX_STEPS = 60
_CONVERGED = 1e-9
_DENSE_NODES = 12
_DENSE_DEGREE = 5

_PIXELS_ACROSS = 1.4
"""Usual focal length in image widths; the nodes of one plane hardly tell it from the distance."""

_PRIOR = np.array([np.inf] * 6 + [0.5, 0.05, 0.05, 0.5, 0.5, 0.005, 0.005])
"""Standard deviations, in the parameters' own units, of what is known before: see ``Lens``."""

_STEP = np.array([1e-5, 1e-5, 1e-5, 1e-3, 1e-3, 1e-5, 1e-3, 1e-4, 1e-4, 1e-4, 1e-4, 1e-6, 1e-6])


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """A camera that looks at a plane.

    ``parameters`` (13,): rotation vector; offset of the axis from the plane's origin (x, y) mm; log of the
    scale px/mm; log of the focal length over its usual value; principal point's offset from the image's
    middle in image widths (u, v); Brown's k1, k2, p1, p2. ``mirrored``: seen from behind.
    """

    parameters: FloatArray
    mirrored: bool
    width: int
    height: int

    def to_px(self, points_mm: FloatArray) -> FloatArray:
        """Project points (n, 2) mm of the plane to (n, 2) px."""
        p = self.parameters
        focal_px = _PIXELS_ACROSS * self.width * math.exp(p[6])
        distance_mm = focal_px / math.exp(p[5])
        side = -1.0 if self.mirrored else 1.0
        plane = np.column_stack([side * points_mm[:, 0], -points_mm[:, 1], np.zeros(len(points_mm))])
        space = plane @ _rotation(p[:3]).T + np.array([p[3], p[4], distance_mm])
        x, y = space[:, 0] / space[:, 2], space[:, 1] / space[:, 2]
        r2 = x * x + y * y
        radial = 1 + r2 * (p[9] + r2 * p[10])
        u = x * radial + 2 * p[11] * x * y + p[12] * (r2 + 2 * x * x)
        v = y * radial + p[11] * (r2 + 2 * y * y) + 2 * p[12] * x * y
        middle = np.array([(self.width - 1) / 2, (self.height - 1) / 2]) + self.width * p[7:9]
        return focal_px * np.column_stack([u, v]) + middle

    def with_parameters(self, parameters: FloatArray) -> Lens:
        """The same camera with other parameters."""
        return Lens(parameters, self.mirrored, self.width, self.height)

    def jacobian(self, points_mm: FloatArray) -> FloatArray:
        """d(px)/d(parameters) as (2 n, 13), by central differences."""
        columns = []
        for index, step in enumerate(_STEP):
            shift = np.zeros(len(_STEP))
            shift[index] = step
            ahead = self.with_parameters(self.parameters + shift).to_px(points_mm)
            behind = self.with_parameters(self.parameters - shift).to_px(points_mm)
            columns.append((ahead - behind).ravel() / (2 * step))
        return np.column_stack(columns)


def fit_lens_map(
    nodes_mm: FloatArray,
    nodes_px: FloatArray,
    hull_mm: FloatArray,
    image_size: tuple[int, int],
) -> Fit:
    """Levenberg and Marquardt's least squares through nodes (n, 2) mm at (n, 2) px, with weak priors.

    The map is kept as a tensor polynomial through the lens on a dense grid, with what the nodes' noise leaves
    in it. Raises ValueError when the nodes are too few or lie on a line.
    """
    if 2 * len(nodes_mm) < 2 * len(_PRIOR):
        raise ValueError(f"{len(nodes_mm)} nodes are too few for a lens model")
    lens, noise_px = _start(nodes_mm, nodes_px, image_size), _FIRST_NOISE_PX
    for _ in range(_ROUNDS):
        lens = _descend(lens, nodes_mm, nodes_px, noise_px)
        residuals = nodes_px - lens.to_px(nodes_mm)
        jacobian = lens.jacobian(nodes_mm)
        covariance = np.linalg.inv(jacobian.T @ jacobian / noise_px**2 + np.diag(1 / _PRIOR**2))
        leverage = jacobian @ covariance @ jacobian.T / noise_px**2
        freedom = 2 * len(nodes_mm) - float(np.trace(leverage))
        noise_px = max(math.sqrt(float(np.square(residuals).sum()) / freedom), 1e-6)
    covariance = np.linalg.inv(jacobian.T @ jacobian / noise_px**2 + np.diag(1 / _PRIOR**2))
    fitted = _as_tensor(lens, nodes_mm, np.linalg.cholesky(covariance), noise_px, hull_mm)
    missed, standard = _unlevered(residuals, leverage)
    return Fit(fitted, residuals, missed, standard)


def _start(nodes_mm: FloatArray, nodes_px: FloatArray, image_size: tuple[int, int]) -> Lens:
    """A camera square to the plane: scale, turn and side from an affine fit."""
    width, height = image_size
    design = np.column_stack([nodes_mm, np.ones(len(nodes_mm))])
    (a, b, origin) = np.linalg.lstsq(design, nodes_px, rcond=None)[0]
    determinant = float(a[0] * b[1] - a[1] * b[0])
    if abs(determinant) < 1e-6:
        raise ValueError("the nodes lie on a line")
    mirrored = determinant > 0  # v runs down and y up
    scale = math.sqrt(abs(determinant))
    side = -1.0 if mirrored else 1.0
    parameters = np.zeros(len(_PRIOR))
    parameters[2] = math.atan2(side * a[1], side * a[0])
    parameters[3] = (origin[0] - (width - 1) / 2) / scale
    parameters[4] = (origin[1] - (height - 1) / 2) / scale
    parameters[5] = math.log(scale)
    return Lens(parameters, mirrored, width, height)


def _descend(lens: Lens, nodes_mm: FloatArray, nodes_px: FloatArray, noise_px: float) -> Lens:
    precision = np.diag(1 / _PRIOR**2)

    def cost(candidate: Lens) -> float:
        miss = (nodes_px - candidate.to_px(nodes_mm)) / noise_px
        prior = candidate.parameters @ precision @ candidate.parameters
        total = float(np.square(miss).sum() + prior)
        return total if math.isfinite(total) else math.inf

    now, damping = cost(lens), 1e-3
    for _ in range(_MAX_STEPS):
        jacobian = lens.jacobian(nodes_mm) / noise_px
        miss = (nodes_px - lens.to_px(nodes_mm)).ravel() / noise_px
        normal = jacobian.T @ jacobian + precision
        gradient = jacobian.T @ miss - precision @ lens.parameters
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
        candidate = lens.with_parameters(lens.parameters + step)
        then = cost(candidate)
        if then < now:
            settled = now - then < _CONVERGED * now
            lens, now, damping = candidate, then, damping / 10
            if settled:
                break
        else:
            damping *= 10
            if damping > 1e12:
                break
    return lens


def _as_tensor(
    lens: Lens,
    nodes_mm: FloatArray,
    parameter_spread: FloatArray,
    noise_px: float,
    hull_mm: FloatArray,
) -> TensorMap:
    """The lens and what is uncertain of it on Gram polynomials over the nodes' rectangle."""
    axes = []
    for column in (0, 1):
        low, high = float(nodes_mm[:, column].min()), float(nodes_mm[:, column].max())
        axes.append(Axis(low, (high - low) / (_DENSE_NODES - 1), _DENSE_NODES))
    x_mm, y_mm = (np.linspace(axis.first_mm, axis.last_mm, axis.nodes) for axis in axes)
    dense_mm = np.stack(np.meshgrid(x_mm, y_mm), axis=-1).reshape(-1, 2)
    bx = gram_basis(axes[0].to_unit(x_mm), _DENSE_NODES, _DENSE_DEGREE)
    by = gram_basis(axes[1].to_unit(y_mm), _DENSE_NODES, _DENSE_DEGREE)
    projector = np.kron(by, bx).T  # unitary on the dense grid: its own pseudo-inverse
    spectra = projector @ lens.to_px(dense_mm)
    changes = (lens.jacobian(dense_mm) @ parameter_spread).reshape(len(dense_mm), 2, -1)
    size = _DENSE_DEGREE + 1
    return TensorMap(
        model="lens",
        x_axis=axes[0],
        y_axis=axes[1],
        spectra=spectra.T.reshape(2, size, size),
        spread_px=np.stack([projector @ changes[:, 0], projector @ changes[:, 1]]),
        noise_px=noise_px,
        hull_mm=hull_mm,
    )


def _unlevered(residuals: FloatArray, leverage: FloatArray) -> tuple[FloatArray, FloatArray]:
    """By how much each node misses the map fitted without it, and the residuals at equal variance.

    With the node's own block H of the leverage these are (1 − H)⁻¹ r and (1 − H)^(−1/2) r.
    """
    missed, standard = np.empty_like(residuals), np.empty_like(residuals)
    for node, residual in enumerate(residuals):
        block = slice(2 * node, 2 * node + 2)
        left, axes = np.linalg.eigh(np.eye(2) - leverage[block, block])
        left = np.maximum(left, 1e-9)
        along = axes.T @ residual
        missed[node], standard[node] = axes @ (along / left), axes @ (along / np.sqrt(left))
    return missed, standard


def _rotation(vector: FloatArray) -> FloatArray:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation: FloatArray = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return rotation
