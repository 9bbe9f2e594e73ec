"""The grey plane that ambient light leaves, found robustly on a coarse picture of the frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import FloatArray, PixelArray

CELL_PX = 8
"""Side of a coarse cell. It covers more than one printed dot, so the print does not show."""

_TILE_ROWS, _TILE_COLUMNS = 6, 8
_OUTLIER_SIGMAS = 2.5
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, slots=True)
class Plane:
    """Background over a frame: level + slope_u · u + slope_v · v, in counts, (u, v) in px."""

    level: float
    slope_u: float
    slope_v: float

    def over(self, left: int, top: int, width: int, height: int) -> npt.NDArray[np.float32]:
        """The plane on a window of pixels, (height, width)."""
        u = (self.level + self.slope_u * np.arange(left, left + width)).astype(np.float32)
        v = (self.slope_v * np.arange(top, top + height)).astype(np.float32)
        return v[:, None] + u[None, :]


def coarse_picture(pixels: PixelArray) -> npt.NDArray[np.float32]:
    """Means over CELL_PX × CELL_PX cells, without single hot pixels.

    Halfway down, a 3 × 3 median removes what is smaller than about 8 px. Rows and columns that do not fill
    a cell are left out: a spot there would be cut by the edge.
    """
    rows, columns = pixels.shape[0] // CELL_PX, pixels.shape[1] // CELL_PX
    whole = pixels[: rows * CELL_PX, : columns * CELL_PX]
    half = cv2.resize(whole, (columns * 2, rows * 2), interpolation=cv2.INTER_AREA)
    half = cv2.medianBlur(half, 3)
    coarse = cv2.resize(half.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(coarse, dtype=np.float32)


def fit_plane(coarse: npt.NDArray[np.float32]) -> Plane:
    """Least squares through the medians of 6 × 8 tiles, without the tiles in which something shines."""
    rows, columns = coarse.shape
    tile_rows, tile_columns = min(_TILE_ROWS, rows), min(_TILE_COLUMNS, columns)
    height, width = rows // tile_rows, columns // tile_columns
    tiles = coarse[: height * tile_rows, : width * tile_columns]
    tiles = tiles.reshape(tile_rows, height, tile_columns, width).swapaxes(1, 2)
    values = np.median(tiles.reshape(tile_rows * tile_columns, -1), axis=1).astype(np.float64)
    design = _tile_design(tile_rows, tile_columns, height, width)
    kept = values <= np.median(values) + _OUTLIER_SIGMAS * _sigma(values - np.median(values)) + 1.0
    solution: FloatArray = np.zeros(3)
    for _ in range(3):
        solution = np.asarray(np.linalg.lstsq(design[kept], values[kept], rcond=None)[0])
        residual = values - design @ solution
        kept = np.abs(residual) <= _OUTLIER_SIGMAS * _sigma(residual[kept]) + 0.5
        if np.count_nonzero(kept) < len(values) // 3:
            break
    return Plane(float(solution[0]), float(solution[1]), float(solution[2]))


@lru_cache(maxsize=8)
def _tile_design(tile_rows: int, tile_columns: int, height: int, width: int) -> FloatArray:
    """Rows (1, u, v) at the tiles' middles, in px of the frame."""
    u = (np.arange(tile_columns) + 0.5) * width * CELL_PX - 0.5
    v = (np.arange(tile_rows) + 0.5) * height * CELL_PX - 0.5
    grid_u, grid_v = np.meshgrid(u, v)
    return np.column_stack([np.ones(grid_u.size), grid_u.ravel(), grid_v.ravel()])


def excess_over(coarse: npt.NDArray[np.float32], plane: Plane) -> npt.NDArray[np.float32]:
    """The coarse picture without the background plane, in counts."""
    rows, columns = coarse.shape
    middle = (CELL_PX - 1) / 2
    u = plane.level + plane.slope_u * (np.arange(columns) * CELL_PX + middle)
    v = plane.slope_v * (np.arange(rows) * CELL_PX + middle)
    return coarse - (v[:, None] + u[None, :]).astype(np.float32)


def robust_sigma(values: npt.NDArray[np.float32]) -> float:
    """Standard deviation by the median absolute value, deaf to what shines; for values about zero."""
    magnitudes = np.abs(values.ravel())
    middle = magnitudes.size // 2
    return _MAD_TO_SIGMA * float(np.partition(magnitudes, middle)[middle])


def pixel_noise(pixels: PixelArray, plane: Plane) -> float:
    """Noise of one background pixel in counts, from a sparse sample of the frame.

    The median absolute deviation only sets the limit up to which deviations are averaged, since on integer
    counts it moves in steps; 1/12 is the variance of rounding, below which no camera goes.
    """
    step_v, step_u = max(pixels.shape[0] // 40, 1), max(pixels.shape[1] // 50, 1)
    sample = pixels[::step_v, ::step_u].astype(np.float32)
    sample -= plane.level
    sample -= (plane.slope_u * step_u * np.arange(sample.shape[1])).astype(np.float32)
    sample -= (plane.slope_v * step_v * np.arange(sample.shape[0])).astype(np.float32)[:, None]
    limit = 4.0 * (robust_sigma(sample) + 0.5)
    inner = sample[np.abs(sample) <= limit]
    return float(np.sqrt(np.mean(np.square(inner)) + 1 / 12)) if inner.size else limit


def _sigma(values: FloatArray) -> float:
    return _MAD_TO_SIGMA * float(np.median(np.abs(values)))
