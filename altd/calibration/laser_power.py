"""The laser's power in each exposure of a flat, from that seen through a response that took it as constant.

Where spots overlap, part of what an exposure has more than usual went into the response, so it seems to have
less: with a_k the true excess of exposure k, the seen one is r = a − G a. G is a mean over neighbours: the
excess is spread with the weights of the spot about each p_k, divided by their sum, and gathered with them.
That follows from the positions alone, so a = (1 − G)⁻¹ r takes no further pass over the frames. What is
smooth over the raster is hardly seen; there the prior decides, and so for constant power.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import FloatArray
from altd.vision.image import Image

_CELLS_PER_DIAMETER = 12
_MIN_WEIGHT = 1e-3
_MIN_PRIOR = 0.02
"""Of the variance that a has by its prior: errors of r of second order, such as those of the first map."""
_MAX_STEPS = 300
_CONVERGED = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Positions on a grid of square cells, between whose middles a value is shared."""

    shape: tuple[int, int]
    corners: npt.NDArray[np.intp]
    shares: FloatArray

    @classmethod
    def of(cls, positions_mm: FloatArray, cell_mm: float, rim: int) -> _Cells:
        """Of positions (n, 2), with ``rim`` cells around."""
        places = (positions_mm - positions_mm.min(axis=0)) / cell_mm + rim
        columns, rows = (places.max(axis=0).astype(int) + rim + 2).tolist()
        first = np.floor(places).astype(np.intp)
        right, down = (places - first).T
        corner = first[:, 1] * columns + first[:, 0]
        return cls(
            (rows, columns),
            np.stack([corner, corner + 1, corner + columns, corner + columns + 1]),
            np.stack([(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down]),
        )

    def spread(self, values: FloatArray) -> FloatArray:
        """Values (n,) at the positions, on the grid."""
        cells = math.prod(self.shape)
        sums = np.bincount(self.corners.ravel(), (self.shares * values).ravel(), cells)
        return sums.reshape(self.shape).astype(np.float64)

    def gathered(self, field: FloatArray) -> FloatArray:
        """A field of the grid at the positions, (n,)."""
        values: FloatArray = (field.ravel()[self.corners] * self.shares).sum(axis=0)
        return values


def true_excess(
    positions_mm: FloatArray, seen: FloatArray, noise: FloatArray, weights: Image, diameter_mm: float
) -> FloatArray:
    """The excess power a (n,) of exposures at positions (n, 2), from the ``seen`` one r.

    ``noise`` (n,) is the standard deviation of r by the noise of the pixels; ``weights`` are those of the
    light about a position, a square table over two diameters. Solved by conjugate gradients.
    """
    size = 2 * _CELLS_PER_DIAMETER + 1
    kernel = cv2.resize(weights.astype(np.float64), (size, size), interpolation=cv2.INTER_AREA)
    kernel = (kernel + kernel[::-1, ::-1]) / (2 * kernel.sum())
    cells = _Cells.of(positions_mm, diameter_mm / _CELLS_PER_DIAMETER, _CELLS_PER_DIAMETER)

    def blurred(field: FloatArray) -> FloatArray:
        return np.asarray(cv2.filter2D(field, -1, kernel, borderType=cv2.BORDER_CONSTANT))

    total = blurred(cells.spread(np.ones(len(seen))))
    lit = total > _MIN_WEIGHT * total.max()
    per_total = np.where(lit, 1 / np.where(lit, total, 1), 0.0)
    own = cells.gathered(blurred(lit.astype(np.float64)))
    x, y = (positions_mm / np.maximum(np.abs(positions_mm).max(axis=0), 1e-9)).T
    smooth = np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y], axis=1)
    seen = seen - smooth @ np.linalg.lstsq(smooth, seen, rcond=None)[0]
    prior = _MIN_PRIOR + float(np.median(np.square(noise))) / max(float(np.mean(np.square(seen))), 1e-12)

    def applied(excess: FloatArray) -> FloatArray:
        neighbours = cells.gathered(blurred(blurred(cells.spread(excess)) * per_total))
        product: FloatArray = own * (1 + prior) * excess - neighbours
        return product

    right = own * seen
    excess = np.zeros_like(seen)
    rest = right
    step = rest
    square = float(rest @ rest)
    enough = _CONVERGED**2 * square
    for _ in range(_MAX_STEPS):
        if square <= enough:
            break
        product = applied(step)
        length = square / float(step @ product)
        excess = excess + length * step
        rest = rest - length * product
        before, square = square, float(rest @ rest)
        step = rest + square / before * step
    return excess
