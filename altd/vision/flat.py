"""How much of the light each pixel shows: the flat field of one target (printed dots, grain, fall-off)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]

BLOCK_PX = 4
"""Side of the blocks into which a spot is summed before it is fitted."""


@dataclass(frozen=True, eq=False)
class Flat:
    """A target's response F to even light, (rows, columns), mean 1.

    What a pixel shows of an irradiance E is E · F.
    """

    response: Image

    @cached_property
    def blocks(self) -> BlockSums:
        """The sums over whole blocks of BLOCK_PX."""
        return block_sums(self.response, 0, 0, BLOCK_PX)


@dataclass(frozen=True, slots=True, eq=False)
class BlockSums:
    """Sums of powers of F over square blocks, each (rows, columns) of blocks.

    ``f1`` … ``f4`` are ΣF … ΣF⁴. ``u_px`` and ``v_px`` are where a block measures: its centroid weighted with
    F², so that ΣF·(E·F) is E there times ΣF² for an irradiance that is linear over the block.
    """

    f1: Image
    f2: Image
    f3: Image
    f4: Image
    u_px: Image
    v_px: Image

    def cut(self, rows: slice, columns: slice) -> BlockSums:
        """Some of the blocks."""
        return BlockSums(*(getattr(self, name)[rows, columns] for name in self.__slots__))


def block_sums(response: Image, left: int, top: int, size: int) -> BlockSums:
    """The sums of a part of a flat whose first pixel is (left, top); incomplete blocks are left out."""
    rows, columns = response.shape
    u = np.arange(left, left + columns, dtype=np.float32)
    v = np.arange(top, top + rows, dtype=np.float32)[:, None]
    square = response * response
    f2 = block_sum(square, size)
    floor = np.maximum(f2, np.float32(1e-12))
    middle_u, middle_v = block_sum(square * 0 + u, size) / size**2, block_sum(square * 0 + v, size) / size**2
    lit = f2 > 1e-9
    return BlockSums(
        f1=block_sum(response, size),
        f2=f2,
        f3=block_sum(square * response, size),
        f4=block_sum(square * square, size),
        u_px=np.where(lit, block_sum(square * u, size) / floor, middle_u),
        v_px=np.where(lit, block_sum(square * v, size) / floor, middle_v),
    )


def block_sum(image: Image, size: int) -> Image:
    """Sums over size × size pixels; rows and columns that fill no block are left out."""
    if size == 1:
        return image
    rows, columns = image.shape[0] // size, image.shape[1] // size
    whole = image[: rows * size, : columns * size]
    means = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(means, dtype=np.float32) * np.float32(size * size)
