"""Polynomials of the maps: Gram's orthonormal basis on equidistant nodes (thesis 3.5.2), and Horner's rule.

The daemon evaluates single points by Horner's rule: numpy's calls cost ten times the arithmetic for them.
"""

from __future__ import annotations

import math

import numpy as np

from altd.records import FloatArray


def gram_basis(x: FloatArray, nodes: int, degree: int) -> FloatArray:
    """Return the unitary Gram polynomials g₀ … g_degree at ``x``.

    ``x`` (n,) is in the units of Eq. 3.22, where the nodes are at −1 + (2k − 1)/nodes; between the nodes the
    polynomials interpolate. Returns (n, degree + 1). On the nodes the columns are orthonormal (the √m scaling
    below Eq. 3.22). Raises ValueError for a degree that the nodes cannot carry.

    Eq. 3.20 is printed with n² − 1/2, with which they are not orthonormal; n² − 1/4 is in R. W. Barnard et
    al., "Gram polynomials and the Kummer function", J. Approx. Theory 94 (1998).
    """
    if not 0 <= degree < nodes:
        raise ValueError(f"degree {degree} needs at least {degree + 1} nodes, there are {nodes}")
    value = np.zeros((len(x), degree + 1))
    value[:, 0] = 1 / math.sqrt(nodes)
    alpha_before = 1.0
    for n in range(1, degree + 1):  # Eq. 3.19–3.21
        alpha = _alpha(n, nodes)
        value[:, n] = 2 * alpha * x * value[:, n - 1]
        if n > 1:
            value[:, n] -= alpha / alpha_before * value[:, n - 2]
        alpha_before = alpha
    return value


def gram_powers(nodes: int, degree: int) -> FloatArray:
    """Return the coefficients of g₀ … g_degree, one per row, by rising powers of x, for the degrees of a map.

    They agree with ``gram_basis`` to 1e-14 up to degree 15; far above, powers cancel and lose digits.
    """
    powers = np.zeros((degree + 1, degree + 1))
    powers[0, 0] = 1 / math.sqrt(nodes)
    for n in range(1, degree + 1):
        powers[n, 1:] = 2 * _alpha(n, nodes) * powers[n - 1, :-1]
        if n > 1:
            powers[n] -= _alpha(n, nodes) / _alpha(n - 1, nodes) * powers[n - 2]
    return powers


def _alpha(n: int, nodes: int) -> float:
    """Return α of Eq. 3.20, for n ≥ 1."""
    return nodes / n * math.sqrt((n * n - 0.25) / (nodes * nodes - n * n))


Rows = tuple[tuple[float, ...], ...]
"""Coefficients c_ij of y^i x^j, rows by falling i and columns by falling j."""


def rows(powers: FloatArray) -> Rows:
    """Return a matrix of coefficients by rising powers in the form for Horner's rule."""
    return plain(powers[::-1, ::-1])


def plain(matrix: FloatArray) -> Rows:
    """Return a matrix as tuples of numbers."""
    return tuple(tuple(row) for row in matrix.tolist())


def horner(coefficients: Rows, x: float, y: float) -> float:
    """Return Σ c_ij x^j y^i."""
    value = 0.0
    for row in coefficients:
        along_x = 0.0
        for coefficient in row:
            along_x = along_x * x + coefficient
        value = value * y + along_x
    return value


def horner_with_slopes(coefficients: Rows, x: float, y: float) -> tuple[float, float, float]:
    """Return Σ c_ij x^j y^i with its derivatives by x and by y."""
    value = slope_x = slope_y = 0.0
    for row in coefficients:
        along_x = slope = 0.0
        for coefficient in row:
            slope = slope * x + along_x
            along_x = along_x * x + coefficient
        slope_y = slope_y * y + value
        slope_x = slope_x * y + slope
        value = value * y + along_x
    return value, slope_x, slope_y
