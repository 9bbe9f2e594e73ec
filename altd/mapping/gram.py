"""Gram polynomials: discrete orthonormal basis functions on equidistant nodes (thesis 3.5.2)."""

from __future__ import annotations

import math

import numpy as np

from altd.records import FloatArray


def gram_basis(x: FloatArray, nodes: int, degree: int) -> FloatArray:
    """Unitary Gram polynomials g₀ … g_degree at ``x``.

    ``x`` (n,) is in the units of Eq. 3.22, where the nodes lie at −1 + (2k − 1)/nodes; between the nodes the
    polynomials interpolate. Returns (n, degree + 1). On the nodes the columns are orthonormal
    (the √m scaling below Eq. 3.22). Raises ValueError for a degree that the nodes cannot carry.

    Eq. 3.20 is printed with n² − 1/2, with which they are not; n² − 1/4 is what R. W. Barnard et al., "Gram
    polynomials and the Kummer function", J. Approx. Theory 94 (1998), have.
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
    """Coefficients of g₀ … g_degree, one a row, by rising powers of x: for the degrees of a map.

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
    """Eq. 3.20, for n ≥ 1."""
    return nodes / n * math.sqrt((n * n - 0.25) / (nodes * nodes - n * n))
