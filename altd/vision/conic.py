"""An ellipse through points by direct linear least squares (thesis 2.1.2, Eq. 2.2-2.6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from altd.records import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Conic:
    """The centre (x, y) of an ellipse, in the unit of its points, and its sensitivity to each point.

    ``sensitivities`` (2, n): by how much x and y rise when a point goes outwards, along the ellipse's normal,
    by one; to first order in the points' distances from the ellipse.
    """

    x: float
    y: float
    sensitivities: FloatArray


def fit_conic(x: FloatArray, y: FloatArray) -> Conic | None:
    """The ellipse through points (n,) that are mean-free and of a size about 1; None when there is none.

    Least squares of the algebraic distances e = D z (Eq. 2.3-2.6). The constant and the linear terms are
    eliminated by orthogonal residualisation of D2 against (D1, D0); under the constraint C1, b² − 4ac = −1,
    z2 is then an eigenvector of a 3 × 3 matrix, the one that is an ellipse. (D2's columns are x², xy, y²,
    in the order of Eq. 2.2; Eq. 2.4 and 2.6 have them in two orders.) C1 makes the ellipse of noisy points
    too small, which does not affect its centre when they go all around. On a spot whose contours are similar
    ellipses, the algebraic distance of a point is proportional to the irradiance by which it is wrong, so
    that the distances deserve equal weights.
    """
    squares = np.stack([x * x, x * y, y * y], axis=1)
    rest = np.stack([x, y, np.ones_like(x)], axis=1)
    try:
        coefficients = _coefficients(squares, rest)
        return None if coefficients is None else _centre(coefficients, np.column_stack([squares, rest]))
    except np.linalg.LinAlgError:
        return None


def _coefficients(squares: FloatArray, rest: FloatArray) -> FloatArray | None:
    """The conic's a … f, a positive, of the columns (n, 3) of D2 and of (D1, D0)."""
    eliminated = np.linalg.solve(rest.T @ rest, rest.T @ squares)
    residual = squares - rest @ eliminated
    scatter = residual.T @ residual
    # C1 is z2ᵀ C z2 = 1 with C = [[0, 0, 2], [0, -1, 0], [2, 0, 0]]
    _, vectors = np.linalg.eig(np.stack([scatter[2] / 2, -scatter[1], scatter[0] / 2]))
    vectors = np.real(vectors)
    discriminants = 4 * vectors[0] * vectors[2] - vectors[1] ** 2
    if discriminants.max() <= 0:
        return None
    quadratic = vectors[:, int(discriminants.argmax())]
    if quadratic[0] < 0:
        quadratic = -quadratic
    return np.concatenate([quadratic, -eliminated @ quadratic])


def _centre(coefficients: FloatArray, design: FloatArray) -> Conic:
    """Where the conic's gradient is zero, and how that moves with the points of a design (n, 6)."""
    a, b, c, d, e, _ = coefficients
    x, y = design[:, 3], design[:, 4]
    hessian = np.array([[2 * a, b], [b, 2 * c]])
    u, v = -np.linalg.solve(hessian, (d, e))
    of_coefficients = -np.linalg.solve(hessian, [[2 * u, v, 0, 1, 0, 0], [0, u, 2 * v, 0, 1, 0]])
    # the scale of the coefficients does not affect the centre: it is held fixed
    scale_only = np.outer(coefficients, coefficients) / (coefficients @ coefficients)
    keep = np.eye(6) - scale_only
    inverse = np.linalg.inv(keep @ design.T @ design @ keep + len(x) * scale_only)
    slope = np.hypot(2 * a * x + b * y + d, b * x + 2 * c * y + e)
    sensitivities: FloatArray = -(of_coefficients @ inverse @ design.T) * slope
    return Conic(float(u), float(v), sensitivities)
