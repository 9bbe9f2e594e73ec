"""The places at which the Gram polynomials of so many nodes are orthonormal."""

import numpy as np


def equidistant_nodes(count: int) -> np.ndarray:
    """The nodes of Eq. 3.22: the middles of ``count`` equal parts of −1 … 1."""
    edges = np.linspace(-1, 1, count + 1)
    return (edges[:-1] + edges[1:]) / 2
