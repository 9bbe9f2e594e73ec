"""Surroundings of a spot as sums over blocks of pixels: the data vectors of the fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from altd.records import FloatArray
from altd.vision.flat import BLOCK_PX, BlockSums, Flat, block_sum, block_sums
from altd.vision.frame_analysis import Patch
from altd.vision.image import Image, Noise

LIGHT, MONOMIALS, HALF_MOMENTS, F1, F2 = 0, slice(1, 7), slice(7, 10), 10, 11
READ_NOISE, SHOT_NOISE, SPOT_TEXTURE, ROWS = range(12, 16)


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Blocks as the columns of one array, ``rows`` (15, n), in the layout that compiled code reads.

    LIGHT is Σ F·I, F1 and F2 the sums of F and F². MONOMIALS are 1, x, y, x², xy, y² of the blocks'
    positions, which count from the initial estimate in units of its sigma. HALF_MOMENTS are ½ xx, xy, ½ yy,
    half the second moments of F² about the positions; without ``has_moments`` they are the same in all
    blocks, only widen the spot, and are not set. READ_NOISE, SHOT_NOISE per count of irradiance and
    SPOT_TEXTURE per squared count of irradiance and squared texture contrast are variances of the light.
    """

    rows: FloatArray
    has_moments: bool
    widening_px2: float = 0.0
    """Variance that the blocks add to a spot's, px²."""

    def only(self, kept: npt.NDArray[np.bool_]) -> Blocks:
        """Return the blocks that the mask ``kept`` selects."""
        return replace(self, rows=self.rows[:, kept])


def blocks_of(
    patch: Patch,
    flat: Flat | None,
    clipped: npt.NDArray[np.bool_] | None,
    noise: Noise,
    sigma_px: float,
    size: int,
) -> Blocks:
    """Return the blocks of ``size`` × ``size`` px.

    Positions count from the outline's centroid in units of ``sigma_px``. Pixels in the mask ``clipped`` of
    the patch are excluded.
    """
    light, sums = _sums(patch, flat, clipped, size)
    f1, f2, f3, f4, u, v = sums.planes[:6].reshape(6, -1)
    rows = np.empty((ROWS, f1.size))
    rows[LIGHT] = np.ravel(light)
    one, x, y, xx, xy, yy = rows[MONOMIALS]
    one[:] = 1
    np.multiply(u - (patch.left + patch.outline.u), 1 / sigma_px, out=x)
    np.multiply(v - (patch.top + patch.outline.v), 1 / sigma_px, out=y)
    np.multiply(x, x, out=xx)
    np.multiply(x, y, out=xy)
    np.multiply(y, y, out=yy)
    has_moments = flat is not None or clipped is not None
    if has_moments:
        halves = np.array([[0.5], [1.0], [0.5]]) / sigma_px**2
        np.multiply(sums.planes[6:].reshape(3, -1), halves, out=rows[HALF_MOMENTS])
    rows[F1], rows[F2] = f1, f2
    np.multiply(np.maximum(f2, 1e-9), noise.read_counts**2, out=rows[READ_NOISE])
    np.multiply(f3, 1 / noise.electrons_per_count, out=rows[SHOT_NOISE])
    rows[SPOT_TEXTURE] = f4
    return Blocks(rows, has_moments, 0.0 if has_moments else (size**2 - 1) / 12)


def _sums(
    patch: Patch, flat: Flat | None, clipped: npt.NDArray[np.bool_] | None, size: int
) -> tuple[Image, BlockSums]:
    """Return Σ F·I over the patch's blocks and the sums of F, cut out of the flat's sums where possible."""
    height, width = patch.excess.shape
    if flat is None and clipped is None:
        return block_sum(patch.excess, size), _plain_sums(height, width, size).shifted(patch.left, patch.top)
    if flat is None:
        response = np.ones((height, width), np.float32)
    else:
        response = flat.response[patch.top : patch.top + height, patch.left : patch.left + width]
    if clipped is not None:
        response = np.where(clipped, np.float32(0), response)
    light = block_sum(patch.excess * response, size)
    if flat is None or clipped is not None or size != BLOCK_PX:
        return light, block_sums(response, patch.left, patch.top, size)
    top, left = patch.top // size, patch.left // size
    rows, columns = height // size, width // size
    return light, flat.blocks.cut(slice(top, top + rows), slice(left, left + columns))


@lru_cache(maxsize=64)
def _plain_sums(height: int, width: int, size: int) -> BlockSums:
    """Return the block sums of a plain target, which depend only on the patch's size."""
    return block_sums(np.ones((height, width), np.float32), 0, 0, size)
