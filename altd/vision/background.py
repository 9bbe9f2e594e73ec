"""What ambient light leaves in a frame, found robustly on a coarse picture of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import FloatArray, PixelArray

Image = npt.NDArray[np.float32]

CELL_PX = 8
"""Side of a coarse cell. It covers more than one printed dot, so the print does not show."""

_TILE_ROWS, _TILE_COLUMNS = 6, 8
_OUTLIER_SIGMAS = 2.5
_REFINEMENTS = 3
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, slots=True)
class Background:
    """Smooth background over a frame, counts: a polynomial of second degree in (u, v) px.

    Ambient light seen through a lens falls off towards the corners, which a plane would miss.
    ``coefficients`` belong to 1, u, v, u², uv, v², with (u, v) in units of ``scale_px``.
    """

    coefficients: tuple[float, float, float, float, float, float]
    scale_px: float

    @property
    def level(self) -> float:
        """The background in the frame's first pixel."""
        return self.coefficients[0]

    def at(self, u_px: FloatArray, v_px: FloatArray) -> Image:
        """The background on the grid of columns ``u_px`` (w,) and rows ``v_px`` (h,), as (h, w)."""
        c0, cu, cv, cuu, cuv, cvv = self.coefficients
        u, v = u_px / self.scale_px, v_px / self.scale_px
        along_u = (c0 + u * (cu + u * cuu)).astype(np.float32)
        along_v = (v * (cv + v * cvv)).astype(np.float32)
        mixed: Image = v.astype(np.float32)[:, None] * (cuv * u).astype(np.float32)
        mixed += along_u[None, :]
        mixed += along_v[:, None]
        return mixed


def coarse_picture(pixels: PixelArray) -> Image:
    """Means over CELL_PX × CELL_PX cells, without single hot pixels.

    Halfway down, a 3 × 3 median removes what is smaller than about 8 px. Rows and columns that do not fill
    a cell are left out: a spot there would be cut by the edge.
    """
    rows, columns = pixels.shape[0] // CELL_PX, pixels.shape[1] // CELL_PX
    whole = pixels[: rows * CELL_PX, : columns * CELL_PX]
    half = cv2.medianBlur(_quarter_size(whole), 3)
    coarse = cv2.resize(half.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(coarse, dtype=np.float32)


def _quarter_size(pixels: PixelArray) -> PixelArray:
    """Rounded means over 4 × 4 px: ``cv2.resize`` with INTER_AREA, in half its time for 8 bits.

    Four rows are added up in 16 bits; then four columns at a time are the lanes of one 64-bit word, whose
    product with 1 + 2¹⁶ + 2³² + 2⁴⁸ has their sum, at most 16 · 255, in the highest lane.
    """
    rows, columns = pixels.shape[0] // 4, pixels.shape[1] // 4
    if pixels.dtype != np.uint8:
        return cast("PixelArray", cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA))
    four_rows = np.add(pixels[0::4], pixels[1::4], dtype=np.uint16, order="C")
    four_rows += pixels[2::4]
    four_rows += pixels[3::4]
    sums = (four_rows.view(np.uint64) * np.uint64(0x0001_0001_0001_0001)) >> np.uint64(48)
    return np.rint(sums.astype(np.float32) / 16).astype(np.uint8)


def fit_background(coarse: Image) -> Background:
    """Least squares through the medians of 6 × 8 tiles, without the tiles in which something shines."""
    rows, columns = coarse.shape
    tile_rows, tile_columns = min(_TILE_ROWS, rows), min(_TILE_COLUMNS, columns)
    height, width = rows // tile_rows, columns // tile_columns
    tiles = coarse[: height * tile_rows, : width * tile_columns]
    tiles = tiles.reshape(tile_rows, height, tile_columns, width).swapaxes(1, 2)
    values = _medians(tiles.reshape(tile_rows * tile_columns, -1)).astype(np.float64)
    scale_px = float(max(rows, columns) * CELL_PX)
    design = _tile_design(tile_rows, tile_columns, height, width, scale_px)
    middle = float(_medians(values))
    kept = values <= middle + _OUTLIER_SIGMAS * _sigma(values - middle) + 1.0
    solution: FloatArray = np.array([middle, 0, 0, 0, 0, 0])
    for _ in range(_REFINEMENTS):
        if np.count_nonzero(kept) < len(values) // 3:
            break
        solution = np.asarray(np.linalg.lstsq(design[kept], values[kept], rcond=None)[0])
        residual = values - design @ solution
        kept_before, kept = kept, np.abs(residual) <= _OUTLIER_SIGMAS * _sigma(residual[kept]) + 0.5
        if np.array_equal(kept, kept_before):
            break
    c0, cu, cv, cuu, cuv, cvv = (float(value) for value in solution)
    return Background((c0, cu, cv, cuu, cuv, cvv), scale_px)


@lru_cache(maxsize=8)
def _tile_design(tile_rows: int, tile_columns: int, height: int, width: int, scale_px: float) -> FloatArray:
    """Rows (1, u, v, u², uv, v²) at the tiles' middles, in units of ``scale_px``."""
    u = ((np.arange(tile_columns) + 0.5) * width * CELL_PX - 0.5) / scale_px
    v = ((np.arange(tile_rows) + 0.5) * height * CELL_PX - 0.5) / scale_px
    grid_u, grid_v = (grid.ravel() for grid in np.meshgrid(u, v))
    return np.column_stack([np.ones(grid_u.size), grid_u, grid_v, grid_u**2, grid_u * grid_v, grid_v**2])


def excess_over(coarse: Image, background: Background) -> Image:
    """The coarse picture without the background, in counts."""
    rows, columns = coarse.shape
    middle = (CELL_PX - 1) / 2
    u_px = np.arange(columns, dtype=np.float64) * CELL_PX + middle
    v_px = np.arange(rows, dtype=np.float64) * CELL_PX + middle
    return np.subtract(coarse, background.at(u_px, v_px))


def robust_sigma(values: Image) -> float:
    """Standard deviation by the median absolute value, deaf to what shines; for values about zero."""
    magnitudes = np.abs(values.ravel())
    middle = magnitudes.size // 2
    return _MAD_TO_SIGMA * float(np.partition(magnitudes, middle)[middle])


def pixel_noise(pixels: PixelArray, background: Background) -> float:
    """Noise of one background pixel in counts, from a sparse sample of the frame.

    The median absolute deviation only sets the limit up to which deviations are averaged, since on integer
    counts it moves in steps; 1/12 is the variance of rounding, below which no camera goes.
    """
    step_v, step_u = max(pixels.shape[0] // 40, 1), max(pixels.shape[1] // 50, 1)
    sample = pixels[::step_v, ::step_u].astype(np.float32)
    sample -= background.at(
        step_u * np.arange(sample.shape[1], dtype=np.float64),
        step_v * np.arange(sample.shape[0], dtype=np.float64),
    )
    limit = 4.0 * (robust_sigma(sample) + 0.5)
    inner = sample[np.abs(sample) <= limit]
    return float(np.sqrt(np.mean(np.square(inner)) + 1 / 12)) if inner.size else limit


def _sigma(values: FloatArray) -> float:
    return _MAD_TO_SIGMA * float(_medians(np.abs(values)))


def _medians(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """``np.median`` along the last axis, which on fifty values spends its time on checks."""
    ordered = np.sort(values, axis=-1)
    count = values.shape[-1]
    middle: npt.NDArray[Any] = (
        ordered[..., (count - 1) // 2] + ordered[..., count // 2]
    ) / values.dtype.type(2)
    return middle
