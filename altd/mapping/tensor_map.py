"""Map of one target: mm grid → px by a bivariate tensor polynomial (thesis 3.5.3–3.5.6)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval2d

from altd.mapping.grid import MIN_LINES, Axis, contains
from altd.mapping.polynomials import gram_basis, gram_powers
from altd.records import FloatArray

Model = Literal["tensor", "lens", "fisheye", "lens+tensor", "fisheye+tensor"]
"""Model that was fitted: the tensor polynomial itself, or a lens that it represents."""

ROUND = 1.0, 0.0, 1.0
"""Shape (uu, uv, vv) of noise that is the same along both axes."""
_POINTS_ACROSS = 21
"""Number of points along each axis for figures of the whole hull."""

_MAX_DEGREE = 6
_MIN_DEGREES_OF_FREEDOM = 2
_MIN_FREE_SHARE = 0.25
"""Minimum share of the nodes' data that a degree leaves free to be chosen by generalised cross-validation:
with less it takes noise for a bend."""


def tensor_basis(axes: tuple[Axis, Axis], degree: tuple[int, int], points_mm: FloatArray) -> FloatArray:
    """Return products of Gram polynomials along y and x at points (n, 2), with the degree along x fastest."""
    bx = gram_basis(axes[0].to_unit(points_mm[:, 0]), axes[0].nodes, degree[0])
    by = gram_basis(axes[1].to_unit(points_mm[:, 1]), axes[1].nodes, degree[1])
    basis: FloatArray = np.einsum("ni,nj->nij", by, bx)
    return basis.reshape(len(points_mm), (degree[0] + 1) * (degree[1] + 1))


@dataclass(frozen=True, slots=True, eq=False)
class TensorMap:
    """A fitted map.

    ``model`` is the fitted model: the tensor polynomial itself or a lens that it represents. ``spectra`` (2,
    degree_y + 1, degree_x + 1) holds S_ũ and S_ṽ of Eq. 3.34, in px. ``covariance_factor_px`` (2, K, m), K =
    (degree_x + 1)(degree_y + 1), is a factor F of the spectra's covariance F Fᵀ (Eq. 3.49–3.53), stacked row
    by row: each of the m columns is one independent error of 1 sigma that the nodes' noise leaves.
    ``noise_px`` is the standard deviation of the nodes about the map, pooled over u and v. Averaging
    exposures does not remove it at a new place. Its covariance is ``noise_px``² times ``noise_shape``: the
    elements (uu, uv, vv) of a matrix of trace 2, for spots that are wider along one axis.

    ``hull_mm`` (n, 2) is the convex polygon that its nodes span, counter-clockwise. Up to ``margin_mm``
    beyond it the map is known with its own spread and, in addition, ``beyond_px_per_mm``: one sigma of the
    model's own error, for each mm outside.
    """

    model: Model
    x_axis: Axis
    y_axis: Axis
    spectra: FloatArray
    covariance_factor_px: FloatArray
    noise_px: float
    hull_mm: FloatArray
    margin_mm: float = 0.0
    beyond_px_per_mm: float = 0.0
    noise_shape: tuple[float, float, float] = ROUND

    @property
    def name(self) -> str:
        """Model for display, with its degrees along x and y if they were chosen."""
        return f"tensor {self.degree[0]} × {self.degree[1]}" if self.model == "tensor" else self.model

    @property
    def noise_covariance_px2(self) -> FloatArray:
        """Covariance of the nodes about the map, (2, 2)."""
        uu, uv, vv = self.noise_shape
        return self.noise_px**2 * np.array([[uu, uv], [uv, vv]])

    def with_noise(self, noise_px: float, shape_mm: FloatArray) -> TensorMap:
        """Return the map with nodes' noise of this size and shape (2, 2) in mm, also in its covariance.

        The scale of ``shape_mm`` does not count. The slopes of the map's middle convert it to a shape in px.
        """
        jacobian = self.jacobian(self.hull_mm.mean(axis=0, keepdims=True))[0]
        shape = jacobian @ shape_mm @ jacobian.T
        shape *= 2 / np.trace(shape)
        values, axes = np.linalg.eigh(shape)
        root = axes * np.sqrt(values) @ axes.T
        factor: FloatArray = np.einsum("uv,vkm->ukm", root, self.covariance_factor_px)
        uu, uv, vv = float(shape[0, 0]), float(shape[0, 1]), float(shape[1, 1])
        return replace(self, noise_px=noise_px, covariance_factor_px=factor, noise_shape=(uu, uv, vv))

    @property
    def sigma_px(self) -> float:
        """Rms over the hull, and over u and v, of the error that the nodes' noise leaves in the map."""
        return float(np.sqrt(self.variance_px2(self.dense_mm()).mean()))

    def variance_px2(self, points_mm: FloatArray) -> FloatArray:
        """Return the variances (n, 2) of u and v that the nodes' noise leaves in the map at points (n, 2)."""
        variances: FloatArray = np.square(self.errors_px(points_mm)).sum(axis=2)
        return variances

    def errors_px(self, points_mm: FloatArray) -> FloatArray:
        """Return the independent errors of 1 sigma of the map at points (n, 2), as (n, 2, m)."""
        errors: FloatArray = (self._basis(points_mm) @ self.covariance_factor_px).transpose(1, 0, 2)
        return errors

    @property
    def folds(self) -> bool:
        """Whether the map folds back on itself inside its hull: two places there would share one pixel."""
        determinant = np.linalg.det(self.jacobian(self.dense_mm()))
        return bool(determinant.min() <= 0 <= determinant.max())

    def dense_mm(self) -> FloatArray:
        """Return points (n, 2) on a fine grid over the hull, for figures of all of it."""
        x_mm, y_mm = (
            np.linspace(low, high, _POINTS_ACROSS)
            for low, high in zip(self.hull_mm.min(axis=0), self.hull_mm.max(axis=0), strict=True)
        )
        points = np.stack(np.meshgrid(x_mm, y_mm), axis=-1).reshape(-1, 2)
        return points[contains(self.hull_mm, points)]

    @property
    def degree(self) -> tuple[int, int]:
        """Degrees along x and y."""
        return self.spectra.shape[2] - 1, self.spectra.shape[1] - 1

    def to_px(self, points_mm: FloatArray) -> FloatArray:
        """Map points (n, 2) mm to (n, 2) px. Not limited to the hull: the inverse needs room to search."""
        px: FloatArray = self._basis(points_mm) @ self.spectra.reshape(2, -1).T
        return px

    def _basis(self, points_mm: FloatArray) -> FloatArray:
        """Return the polynomials at points (n, 2), as (n, K), in the order of the spectra."""
        return tensor_basis((self.x_axis, self.y_axis), self.degree, points_mm)

    def jacobian(self, points_mm: FloatArray) -> FloatArray:
        """Return d(u, v)/d(x, y) at points (n, 2), as (n, 2, 2) px/mm."""
        u, v, _ = self.powers()
        q = self.from_middle(points_mm)
        slopes = [
            [polyval2d(q[:, 1], q[:, 0], polyder(powers, axis=axis)) for axis in (1, 0)] for powers in (u, v)
        ]
        per_mm = np.array([self.x_axis.unit_per_mm, self.y_axis.unit_per_mm])
        return np.asarray(np.array(slopes).transpose(2, 0, 1) * per_mm, dtype=np.float64)

    def from_middle(self, points_mm: FloatArray) -> FloatArray:
        """Return points (n, 2) in the axes' units of Eq. 3.22, in which 0 is the middle of an axis."""
        return np.column_stack([self.x_axis.to_unit(points_mm[:, 0]), self.y_axis.to_unit(points_mm[:, 1])])

    def powers(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the map by powers y^i x^j in the axes' units, which cost least for one point.

        ũ and ṽ (degree_y + 1, degree_x + 1) by rising i and j, and the spread of their coefficients.
        """
        degree_x, degree_y = self.degree
        gram_x, gram_y = gram_powers(self.x_axis.nodes, degree_x), gram_powers(self.y_axis.nodes, degree_y)
        u, v = gram_y.T @ self.spectra @ gram_x
        return u, v, np.einsum("kl,ckm->clm", np.kron(gram_y, gram_x), self.covariance_factor_px)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A map and its residuals at the nodes, each (n, 2) px.

    ``residuals_px`` are measured minus mapped, ``leave_one_out_residuals_px`` the same with the map fitted
    without the node; ``standardised_px`` are the residuals scaled to the same variance at every node, near
    the middle of the grid or at its corners, where the map follows them. ``relative_sigma`` (n,) is the given
    scatter of one node relative to another. ``degree`` is that of a tensor polynomial among what was fitted,
    along x and y. ``parameters`` is the number of fitted parameters, for u and v together, and
    ``effective_parameters`` how many of the 2 n coordinates they use up, which is less if priors were known
    (the trace of the leverage).
    """

    map: TensorMap
    residuals_px: FloatArray
    leave_one_out_residuals_px: FloatArray
    standardised_px: FloatArray
    relative_sigma: FloatArray
    degree: tuple[int, int] | None
    parameters: int
    effective_parameters: float

    @property
    def leave_one_out_px(self) -> float:
        """Rms of the leave-one-out residuals over u and v: the error expected at a new place, print included.

        Each residual is divided by its node's relative sigma.
        """
        return float(
            np.sqrt(np.mean(np.square(self.leave_one_out_residuals_px / self.relative_sigma[:, None])))
        )

    @property
    def gcv_px(self) -> float:
        """Root of the generalised cross-validation score: ``leave_one_out_px`` with one leverage for all."""
        rms_px = float(np.sqrt(np.mean(np.square(self.residuals_px / self.relative_sigma[:, None]))))
        return rms_px / (1 - self.effective_parameters / self.residuals_px.size)


def fit_tensor_map(
    nodes_mm: FloatArray,
    nodes_px: FloatArray,
    hull_mm: FloatArray,
    degree: tuple[int, int] | None = None,
    relative_sigma: FloatArray | None = None,
) -> Fit:
    """Fit Eq. 3.26 by least squares to nodes (n, 2) mm with measured positions (n, 2) px.

    The nodes are on a rectangular grid, of which some may be missing; on a complete one the solution is Eq.
    3.35 and 3.36. Without ``degree``, along x and y, the one with the minimum generalised cross-validation
    score is chosen. ``relative_sigma`` (n,) is the factor by which one node scatters more than another.

    Raises ValueError if the nodes are no grid or too few for the degree.
    """
    if degree is None:
        fits = fit_tensor_maps(nodes_mm, nodes_px, hull_mm, relative_sigma)
        return min(fits, key=lambda fit: fit.gcv_px)
    return _fit_degree(nodes_mm, nodes_px, hull_mm, _axes(nodes_mm), degree, relative_sigma)


def fit_tensor_maps(
    nodes_mm: FloatArray, nodes_px: FloatArray, hull_mm: FloatArray, relative_sigma: FloatArray | None = None
) -> list[Fit]:
    """Return the fits of all degrees that the nodes carry: along an axis up to its nodes less two, at most 6.

    Raises ValueError if the nodes are no grid or carry none.
    """
    axes = _axes(nodes_mm)
    lines = (len(np.unique(axis.numbers(along))) for axis, along in zip(axes, nodes_mm.T, strict=True))
    most_x, most_y = (min(count - 2, _MAX_DEGREE) for count in lines)
    fits, complaint = [], ValueError(f"{len(nodes_mm)} nodes are too few for a map")
    for degree in itertools.product(range(1, most_x + 1), range(1, most_y + 1)):
        if (degree[0] + 1) * (degree[1] + 1) > (1 - _MIN_FREE_SHARE) * len(nodes_mm):
            continue
        try:
            fits.append(_fit_degree(nodes_mm, nodes_px, hull_mm, axes, degree, relative_sigma))
        except ValueError as error:
            complaint = error
    if not fits:
        raise complaint
    return fits


def _axes(nodes_mm: FloatArray) -> tuple[Axis, Axis]:
    x_axis, y_axis = Axis.through(nodes_mm[:, 0]), Axis.through(nodes_mm[:, 1])
    if min(x_axis.nodes, y_axis.nodes) < MIN_LINES:
        raise ValueError(f"a grid of {x_axis.nodes} × {y_axis.nodes} nodes is too small for a map")
    return x_axis, y_axis


def _fit_degree(
    nodes_mm: FloatArray,
    nodes_px: FloatArray,
    hull_mm: FloatArray,
    axes: tuple[Axis, Axis],
    degree: tuple[int, int],
    relative_sigma: FloatArray | None,
) -> Fit:
    relative_sigma = np.ones(len(nodes_mm)) if relative_sigma is None else relative_sigma
    each = relative_sigma[:, None]
    design = tensor_basis(axes, degree, nodes_mm) / each
    degrees_of_freedom = len(nodes_mm) - design.shape[1]
    if degrees_of_freedom < _MIN_DEGREES_OF_FREEDOM:
        raise ValueError(
            f"{len(nodes_mm)} nodes are too few for degree {degree[0]} × {degree[1]}, "
            f"which has {design.shape[1]} coefficients"
        )
    unitary, triangle = np.linalg.qr(design)
    if np.linalg.cond(triangle) > 1e4:
        raise ValueError(f"the missing nodes leave degree {degree[0]} × {degree[1]} undetermined")
    back: FloatArray = np.linalg.inv(triangle)
    along = unitary.T @ (nodes_px / each)
    spectra = back @ along
    residuals = nodes_px / each - unitary @ along
    noise_px = float(np.sqrt(np.square(residuals).sum() / (2 * degrees_of_freedom)))
    either = noise_px * back
    nothing = np.zeros_like(either)
    fitted = TensorMap(
        model="tensor",
        x_axis=axes[0],
        y_axis=axes[1],
        spectra=spectra.T.reshape(2, degree[1] + 1, degree[0] + 1),
        covariance_factor_px=np.stack([np.hstack([either, nothing]), np.hstack([nothing, either])]),
        noise_px=noise_px,
        hull_mm=hull_mm,
    )
    left = np.maximum(1 - np.square(unitary).sum(axis=1), 1e-9)[:, None]
    return Fit(
        map=fitted,
        residuals_px=residuals * each,
        leave_one_out_residuals_px=residuals * each / left,
        standardised_px=residuals / np.sqrt(left),
        relative_sigma=relative_sigma,
        degree=degree,
        parameters=2 * design.shape[1],
        effective_parameters=2.0 * design.shape[1],
    )
