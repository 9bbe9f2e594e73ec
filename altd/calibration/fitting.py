"""From nodes to a target's map: which model, and which nodes do not lie where they should."""

from __future__ import annotations

import numpy as np

from altd.mapping.hull import convex_hull_mm
from altd.mapping.lens import fit_lens_map
from altd.mapping.tensor_map import Fit, fit_tensor_map
from altd.records import FloatArray

_OUTLIER_SIGMAS = 6.0
_RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector whose two components scatter by 1."""
_GAIN_OF_FAR, _GAIN_OF_ANY = 0.8, 0.5
"""A node is dropped when the map then misses the others by less than this share of what it did. One that
lies at a corner bends the map after itself and need not look far off: without it the map is far better."""


def fit_nodes(
    nodes_mm: FloatArray,
    nodes_px: FloatArray,
    image_size: tuple[int, int],
    degree: tuple[int, int] | None,
    most_dropped: int,
) -> tuple[Fit, list[int]]:
    """Fit nodes (n, 2) mm at (n, 2) px; returns the fit and the rows it was made without.

    A node without which the map of the others is clearly better, such as one at which the stage was bumped,
    is left out; one after the other, at most ``most_dropped``. Raises ValueError when the nodes are no grid
    or too few.
    """
    kept = np.arange(len(nodes_mm))
    fit = _best_fit(nodes_mm, nodes_px, image_size, degree)
    while len(nodes_mm) - len(kept) < most_dropped:
        off_px = np.linalg.norm(fit.standard_px, axis=1)
        worst = int(off_px.argmax())
        far = off_px[worst] > _OUTLIER_SIGMAS * float(np.median(off_px)) / _RAYLEIGH_MEDIAN
        others = np.delete(kept, worst)
        try:
            without = _best_fit(nodes_mm[others], nodes_px[others], image_size, degree)
        except ValueError:
            break
        if without.left_out_px > (_GAIN_OF_FAR if far else _GAIN_OF_ANY) * fit.left_out_px:
            break
        kept, fit = others, without
    return fit, sorted(set(range(len(nodes_mm))) - set(kept.tolist()))


def _best_fit(
    nodes_mm: FloatArray, nodes_px: FloatArray, image_size: tuple[int, int], degree: tuple[int, int] | None
) -> Fit:
    """The lens model or the plain tensor polynomial, whichever misses a node less that it was not shown.

    A lens model that fails only loses.
    """
    hull_mm = convex_hull_mm(nodes_mm)
    tensor = fit_tensor_map(nodes_mm, nodes_px, hull_mm, degree)
    try:
        lens = fit_lens_map(nodes_mm, nodes_px, hull_mm, image_size)
    except ValueError:
        return tensor
    return min(tensor, lens, key=lambda fit: fit.left_out_px)
