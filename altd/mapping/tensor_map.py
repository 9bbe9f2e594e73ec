"""The map of one target: mm grid → px by a bivariate tensor polynomial (thesis 3.5.3–3.5.6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from altd.mapping.gram import gram_basis, gram_powers
from altd.mapping.grid import Axis
from altd.records import FloatArray

_LARGEST_DEGREE = 4
_FEWEST_NODES = 4


@dataclass(frozen=True, slots=True, eq=False)
class TensorMap:
    """A fitted map.

    ``model`` is what was fitted: the tensor polynomial itself or a lens that it represents. ``spectra``
    (2, degree_y + 1, degree_x + 1) holds S_ũ and S_ṽ of Eq. 3.34, in px. ``spread_px`` (2, K, m),
    K = (degree_x + 1)(degree_y + 1), is what the nodes' noise leaves in the spectra, stacked row by row:
    each of the m columns is one independent error of 1 sigma. Its square is the covariance of Eq. 3.49–3.53.
    ``noise_px`` is the standard deviation of the nodes about the map, pooled over u and v: print and speckle
    scatter alike along both, and 30 nodes leave little freedom to tell. No averaging of exposures removes it
    at a new place. ``hull_mm`` (n, 2) is the convex polygon in which the map is valid, counter-clockwise.
    """

    model: Literal["tensor", "lens"]
    x_axis: Axis
    y_axis: Axis
    spectra: FloatArray
    spread_px: FloatArray
    noise_px: float
    hull_mm: FloatArray

    @property
    def degree(self) -> tuple[int, int]:
        """Degrees along x and y."""
        return self.spectra.shape[2] - 1, self.spectra.shape[1] - 1

    def to_px(self, points_mm: FloatArray) -> FloatArray:
        """Map points (n, 2) mm to (n, 2) px. Not limited to the hull: the inverse needs room to search."""
        degree_x, degree_y = self.degree
        bx = gram_basis(self.x_axis.to_unit(points_mm[:, 0]), self.x_axis.nodes, degree_x)
        by = gram_basis(self.y_axis.to_unit(points_mm[:, 1]), self.y_axis.nodes, degree_y)
        px: FloatArray = np.einsum("ni,cij,nj->nc", by, self.spectra, bx)
        return px

    def powers(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The map by powers y^i x^j in the axes' units, which for one point cost least.

        ũ and ṽ (degree_y + 1, degree_x + 1) by rising i and j, and the spread of their coefficients.
        """
        degree_x, degree_y = self.degree
        gram_x, gram_y = gram_powers(self.x_axis.nodes, degree_x), gram_powers(self.y_axis.nodes, degree_y)
        u, v = gram_y.T @ self.spectra @ gram_x
        return u, v, np.einsum("kl,ckm->clm", np.kron(gram_y, gram_x), self.spread_px)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A map and what was left over at the nodes, each (n, 2) px.

    ``residuals_px`` are measured minus mapped; ``missed_px`` is by how much each node misses the map that is
    fitted without it; ``standard_px`` are the residuals scaled to the same variance at every node, near the
    middle of the grid or at its corners, where the map bends after them.
    """

    map: TensorMap
    residuals_px: FloatArray
    missed_px: FloatArray
    standard_px: FloatArray

    @property
    def left_out_px(self) -> float:
        """Rms over u and v of ``missed_px``: what to expect at a new place, print and speckle included."""
        return float(np.sqrt(np.mean(np.square(self.missed_px))))


def fit_tensor_map(
    nodes_mm: FloatArray,
    nodes_px: FloatArray,
    hull_mm: FloatArray,
    degree: tuple[int, int] | None = None,
) -> Fit:
    """Least squares of Eq. 3.26 through nodes (n, 2) mm with measured positions (n, 2) px.

    The nodes lie on a rectangular grid, of which some may be missing; on a complete one the solution is
    Eq. 3.35 and 3.36. Without ``degree``, along x and y, it is 4 where an axis has six nodes or more, else
    two less than the nodes.

    Raises ValueError when the nodes are no grid or too few for the degree.
    """
    x_axis, y_axis = Axis.through(nodes_mm[:, 0]), Axis.through(nodes_mm[:, 1])
    if min(x_axis.nodes, y_axis.nodes) < _FEWEST_NODES:
        raise ValueError(f"a grid of {x_axis.nodes} × {y_axis.nodes} nodes is too small for a map")
    degree = degree or (min(_LARGEST_DEGREE, x_axis.nodes - 2), min(_LARGEST_DEGREE, y_axis.nodes - 2))
    bx = gram_basis(x_axis.to_unit(nodes_mm[:, 0]), x_axis.nodes, degree[0])
    by = gram_basis(y_axis.to_unit(nodes_mm[:, 1]), y_axis.nodes, degree[1])
    design = np.einsum("ni,nj->nij", by, bx).reshape(len(nodes_mm), -1)
    freedom = len(nodes_mm) - design.shape[1]
    if freedom < 2:
        raise ValueError(
            f"{len(nodes_mm)} nodes are too few for degree {degree[0]} × {degree[1]}, "
            f"which has {design.shape[1]} coefficients"
        )
    normal = design.T @ design
    if np.linalg.cond(normal) > 1e8:
        raise ValueError(f"the missing nodes leave degree {degree[0]} × {degree[1]} undetermined")
    unit_covariance = np.linalg.inv(normal)
    spectra = unit_covariance @ design.T @ nodes_px
    residuals = nodes_px - design @ spectra
    noise_px = float(np.sqrt(np.square(residuals).sum() / (2 * freedom)))
    either = noise_px * np.linalg.cholesky(unit_covariance)
    nothing = np.zeros_like(either)
    fitted = TensorMap(
        model="tensor",
        x_axis=x_axis,
        y_axis=y_axis,
        spectra=spectra.T.reshape(2, degree[1] + 1, degree[0] + 1),
        spread_px=np.stack([np.hstack([either, nothing]), np.hstack([nothing, either])]),
        noise_px=noise_px,
        hull_mm=hull_mm,
    )
    leverage = np.einsum("nk,kl,nl->n", design, unit_covariance, design)
    left = np.maximum(1 - leverage, 1e-9)[:, None]
    return Fit(fitted, residuals, residuals / left, residuals / np.sqrt(left))
