"""A spot's surroundings as sums over blocks of pixels: the data vectors of the fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from altd.records import FloatArray
from altd.vision.centre import Noise
from altd.vision.flat import BLOCK_PX, BlockSums, Flat, block_sum, block_sums
from altd.vision.image import Image
from altd.vision.patch import Patch


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Blocks as vectors: Σ F·I, the sums of F and F², the places they stand for, the variances of Σ F·I."""

    light: FloatArray
    monomials: FloatArray
    """1, x, y, x², xy, y² as rows; places count from the initial estimate in units of its sigma."""
    half_moments: FloatArray | None
    """½ xx, xy, ½ yy as rows, half the second moments of F² about the places; None where they are the same in
    all blocks and only widen the spot."""
    f1: FloatArray
    f2: FloatArray
    read_variance: FloatArray
    shot_variance: FloatArray
    """Per count of irradiance."""
    texture_variance: FloatArray
    """Per squared count of irradiance and squared texture contrast."""

    def only(self, kept: npt.NDArray[np.bool_]) -> Blocks:
        """Some of the blocks."""
        return Blocks(
            self.light[kept],
            self.monomials[:, kept],
            None if self.half_moments is None else self.half_moments[:, kept],
            self.f1[kept],
            self.f2[kept],
            self.read_variance[kept],
            self.shot_variance[kept],
            self.texture_variance[kept],
        )


def blocks_of(
    patch: Patch,
    flat: Flat | None,
    clipped: npt.NDArray[np.bool_] | None,
    noise: Noise,
    sigma_px: float,
    size: int,
) -> Blocks:
    """The blocks of ``size`` × ``size`` px; places count from the outline's middle in units of ``sigma_px``.

    Pixels that are ``clipped``, as a mask of the patch, are left out.
    """
    light, sums = _sums(patch, flat, clipped, size)
    f1, f2, f3, f4, u, v = sums.planes[:6].reshape(6, -1)
    half_moments = None
    if flat is not None or clipped is not None:
        half_moments = sums.planes[6:].reshape(3, -1) * (np.array([[0.5], [1.0], [0.5]]) / sigma_px**2)
    monomials = np.empty((6, f1.size))
    monomials[0] = 1
    _, x, y, xx, xy, yy = monomials
    np.multiply(u - (patch.left + patch.outline.u), 1 / sigma_px, out=x)
    np.multiply(v - (patch.top + patch.outline.v), 1 / sigma_px, out=y)
    np.multiply(x, x, out=xx)
    np.multiply(x, y, out=xy)
    np.multiply(y, y, out=yy)
    return Blocks(
        light=np.ravel(light),
        monomials=monomials,
        half_moments=half_moments,
        f1=f1,
        f2=f2,
        read_variance=noise.read_counts**2 * np.maximum(f2, 1e-9),
        shot_variance=f3 / noise.electrons_per_count,
        texture_variance=f4,
    )


def _sums(
    patch: Patch, flat: Flat | None, clipped: npt.NDArray[np.bool_] | None, size: int
) -> tuple[Image, BlockSums]:
    """Σ F·I over the patch's blocks and the sums of F, cut out of the flat's own sums where possible."""
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
    """Those of a plain target, which depend on a patch's size alone."""
    return block_sums(np.ones((height, width), np.float32), 0, 0, size)
