"""Gram polynomials: discrete orthonormal basis functions on equidistant nodes (thesis 3.5.2)."""

from __future__ import annotations

import math

import numpy as np

from altd.records import FloatArray


def gram_basis(x: FloatArray, nodes: int, degree: int) -> tuple[FloatArray, FloatArray]:
    """Unitary Gram polynomials g₀ … g_degree and their derivatives at ``x``.

    ``x`` (n,) is in the units of Eq. 3.22, where the nodes lie at −1 + (2k − 1)/nodes; between the nodes the
    polynomials interpolate. Returns two arrays (n, degree + 1). On the nodes the columns are orthonormal
    (the √m scaling below Eq. 3.22). Raises ValueError for a degree that the nodes cannot carry.

    Eq. 3.20 is printed with n² − 1/2, with which they are not; n² − 1/4 is what R. W. Barnard et al., "Gram
    polynomials and the Kummer function", J. Approx. Theory 94 (1998), have.
    """
    if not 0 <= degree < nodes:
        raise ValueError(f"degree {degree} needs at least {degree + 1} nodes, there are {nodes}")
    value = np.zeros((len(x), degree + 1))
    slope = np.zeros((len(x), degree + 1))
    value[:, 0] = 1 / math.sqrt(nodes)
    alpha_before = 1.0
    for n in range(1, degree + 1):  # Eq. 3.19–3.21, and its derivative
        alpha = nodes / n * math.sqrt((n * n - 0.25) / (nodes * nodes - n * n))
        value[:, n] = 2 * alpha * x * value[:, n - 1]
        slope[:, n] = 2 * alpha * (value[:, n - 1] + x * slope[:, n - 1])
        if n > 1:
            value[:, n] -= alpha / alpha_before * value[:, n - 2]
            slope[:, n] -= alpha / alpha_before * slope[:, n - 2]
        alpha_before = alpha
    return value, slope


def equidistant_nodes(nodes: int) -> FloatArray:
    """The nodes of Eq. 3.22."""
    return -1 + (2 * np.arange(1, nodes + 1) - 1) / nodes
