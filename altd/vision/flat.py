"""Flat field of one target: the share of the light that each pixel shows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Self

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import FloatArray, Origin
from altd.vision.image import Image

Source = Literal["recording", "laser", "service", "print"]

BLOCK_PX = 4
"""Side of the blocks over which a spot is summed before it is fitted, px."""

_EVEN_BLOCKS = 2.0
"""Sigma of the Gaussian that averages the dots of a print out, blocks."""
_LOCAL_BLOCKS = 37
"""Side of the surroundings whose largest response counts as that of the surface, blocks: 15 mm either way."""
_MAX_END_SHARE = 0.5
"""Share of that response from which there is no surface: glass beyond a print, a frame, nothing recorded."""
_HIDDEN_FROM = 1.35
"""Distance from the end of the surface, in 1/e² radii, below which a beam's asymmetry displaces a spot; below
a quarter of a radius all of it does (drawn beams with coma and skew)."""

_FULL_SCALE = 255
_BRIGHTEST_PERCENT = 99.99


@dataclass(frozen=True, eq=False)
class Learnt:
    """Learnt part of a flat from service: the share of each block (rows, columns), uint8 from 0 to 255.

    ``unlearnt_px`` is the effect of print and texture on a spot where nothing is learnt, ``diameter_px`` the
    1/e² diameter of the spots.
    """

    share: npt.NDArray[np.uint8]
    unlearnt_px: float
    diameter_px: float

    @classmethod
    def of(cls, share: npt.NDArray[np.floating], unlearnt_px: float, diameter_px: float) -> Self:
        """Return the learnt part of shares from 0 to 1."""
        levels = np.rint(np.clip(share, 0, 1) * _FULL_SCALE).astype(np.uint8)
        return cls(levels, unlearnt_px, diameter_px)

    @cached_property
    def _of_spots(self) -> Image:
        """Share of a spot's light on learnt blocks, for a spot at each block; none beyond the picture."""
        share = self.share.astype(np.float32) / np.float32(_FULL_SCALE)
        sigma = self.diameter_px / 4.0 / BLOCK_PX
        return np.asarray(cv2.GaussianBlur(share, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT), np.float32)

    def of_spot(self, u_px: float, v_px: float) -> float:
        """Return the share of the light of a spot at (u, v) that falls on learnt blocks."""
        row, column = (
            min(max(int(at) // BLOCK_PX, 0), size - 1)
            for at, size in zip((v_px, u_px), self.share.shape, strict=True)
        )
        return min(float(self._of_spots[row, column]), 1.0)

    def unknown_px(self, u_px: float, v_px: float) -> float:
        """Return the standard deviation of a spot by what is not learnt below it.

        The effects of the surface's parts on a spot are independent: the shares are of the variance.
        """
        return self.unlearnt_px * math.sqrt(1.0 - self.of_spot(u_px, v_px))


@dataclass(frozen=True, eq=False)
class Flat:
    """Response F of a target to even light, mean 1: a pixel shows E · F of an irradiance E.

    Stored as ``levels`` (rows, columns), uint8 from 0 to the brightest pixel, as in a calibration file: the
    steps are far below the surface texture. A pixel of 0 is not used. ``source`` is a recording of the evenly
    lit target, laser spots at known places or those of ``service``, or a model of its print; ``origin`` is
    the origin of their frames. ``learnt`` is the part that service showed; None: all of it is known.
    """

    levels: npt.NDArray[np.uint8]
    source: Source
    origin: Origin = Origin.CAMERA
    learnt: Learnt | None = None

    @classmethod
    def from_response(
        cls,
        response: npt.NDArray[np.floating],
        source: Source,
        origin: Origin = Origin.CAMERA,
        learnt: Learnt | None = None,
    ) -> Self:
        """Return the flat of a response (rows, columns) in any unit; negative values become 0."""
        brightest = max(float(np.percentile(response, _BRIGHTEST_PERCENT)), 1e-12)
        levels = np.rint(np.clip(response / brightest, 0, 1) * _FULL_SCALE).astype(np.uint8)
        return cls(levels, source, origin, learnt)

    @cached_property
    def response(self) -> Image:
        """Response F, (rows, columns)."""
        response = self.levels.astype(np.float32)
        response /= max(float(self.levels.mean()), 1e-6)
        return response

    @cached_property
    def _inside_px(self) -> Image:
        """Distance of each block from the end of the surface, px; 0 beyond it."""
        even = cv2.GaussianBlur(block_sum(self.response, BLOCK_PX), (0, 0), _EVEN_BLOCKS)
        surface = cv2.dilate(even, np.ones((_LOCAL_BLOCKS, _LOCAL_BLOCKS), np.uint8))
        is_surface = (even > _MAX_END_SHARE * np.asarray(surface)).astype(np.uint8)
        inside = np.asarray(cv2.distanceTransform(is_surface, cv2.DIST_L2, 5), np.float32)
        return np.minimum(inside, np.float32(max(even.shape))) * np.float32(BLOCK_PX)

    def hidden(self, u_px: float, v_px: float, diameter_px: float) -> float:
        """Return which part of a beam's asymmetry displaces a spot at (u, v), since the surface ends in it.

        A spot that is seen whole is displaced as all spots are, so the map contains it: 0. Of one that is
        seen in part, another shape is fitted: up to 1.
        """
        row, column = (
            min(max(int(at) // BLOCK_PX, 0), size - 1)
            for at, size in zip((v_px, u_px), self._inside_px.shape, strict=True)
        )
        return min(max(_HIDDEN_FROM - 2 * float(self._inside_px[row, column]) / diameter_px, 0.0), 1.0)

    @cached_property
    def blocks(self) -> BlockSums:
        """Sums over whole blocks of BLOCK_PX."""
        return block_sums(self.response, 0, 0, BLOCK_PX)


@dataclass(frozen=True, slots=True, eq=False)
class BlockSums:
    """Sums of powers of F over square blocks, and the blocks' positions: ``planes`` (9, rows, columns).

    ΣF, ΣF², ΣF³, ΣF⁴, then u and v in px: a block's centroid weighted with F², so that ΣF·(E·F) is E there
    times ΣF² for an irradiance that is linear over the block; then uu, uv and vv in px², the moments about
    it, for a curved irradiance. One array, since a spot's part is cut out of it for every frame.
    """

    planes: FloatArray

    def cut(self, rows: slice, columns: slice) -> BlockSums:
        """Return the blocks of these rows and columns."""
        return BlockSums(self.planes[:, rows, columns])

    def shifted(self, left: int, top: int) -> BlockSums:
        """Return the same blocks shifted by (left, top) px."""
        planes = self.planes.copy()
        planes[4] += left
        planes[5] += top
        return BlockSums(planes)


def block_sums(response: Image, left: int, top: int, size: int) -> BlockSums:
    """Return the sums of a part of a flat with first pixel (left, top); incomplete blocks are excluded."""
    rows, columns = response.shape[0] // size, response.shape[1] // size
    # relative to the blocks' middles: small numbers keep their digits in float32
    offset = np.arange(size, dtype=np.float32) - np.float32((size - 1) / 2)
    by_column, by_row = np.tile(offset, columns), np.tile(offset, rows)[:, None]
    whole = response[: rows * size, : columns * size]
    square = whole * whole
    f2 = block_sum(square, size)
    share = square / np.repeat(np.repeat(np.maximum(f2, np.float32(1e-12)), size, axis=0), size, axis=1)
    from_u, from_v = block_sum(share * by_column, size), block_sum(share * by_row, size)
    middle_u = np.arange(left, left + size * columns, size, dtype=np.float32) + np.float32((size - 1) / 2)
    middle_v = np.arange(top, top + size * rows, size, dtype=np.float32) + np.float32((size - 1) / 2)
    planes = (
        block_sum(whole, size),
        f2,
        block_sum(square * whole, size),
        block_sum(square * square, size),
        middle_u + from_u,
        middle_v[:, None] + from_v,
        block_sum(share * by_column**2, size) - from_u**2,
        block_sum(share * by_column * by_row, size) - from_u * from_v,
        block_sum(share * by_row**2, size) - from_v**2,
    )
    return BlockSums(np.array(planes, dtype=np.float64))


def block_sum(image: Image, size: int) -> Image:
    """Return sums over size × size pixels; rows and columns that fill no block are excluded."""
    if size == 1:
        return image
    rows, columns = image.shape[0] // size, image.shape[1] // size
    whole = image[: rows * size, : columns * size]
    means = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(means, dtype=np.float32) * np.float32(size * size)
