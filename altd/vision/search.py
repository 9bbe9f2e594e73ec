"""Coarse search: the smooth background of ambient light in a frame, and its bright regions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import FloatArray, PixelArray
from altd.statistics import MAD_TO_SIGMA, mad_sigma, median
from altd.vision.image import Image

CELL_PX = 8
"""Side of a coarse cell, px. It is larger than a printed dot, so that it averages the print out."""

_TILE_ROWS, _TILE_COLUMNS = 6, 8
_OUTLIER_SIGMAS = 2.0
_MAX_ITERATIONS = 3
_TOLERANCE_COUNTS = 0.1
_MIN_CELLS_FOR_FALL_OFF = 1000
"""Minimum number for the terms with r²; in a smaller image, of which a spot covers much, noise hides them."""
_RIDGE = 1e-9 * np.eye(9)
_ROUNDING_BIAS_COUNTS = 0.125
"""Mean error of the mean of four whole numbers, rounded half up: it is off by 0, −1/4, 1/2 or 1/4."""


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """Smooth background over a frame or around a spot, counts.

    ``by_power`` (5, 5) multiplies the powers of v, row by row, and of u, with (u, v) from ``middle_px`` in
    units of ``scale_px``.
    """

    by_power: Image
    middle_px: tuple[float, float]
    scale_px: float
    uneven_counts: float = 0.0
    """Rms of what a background around a spot leaves unexplained there; 0 for that of a whole frame."""

    @property
    def level(self) -> float:
        """Background in the middle of the frame."""
        return float(self.by_power[0, 0])

    def levels(
        self, first_px: tuple[float, float], shape: tuple[int, int], step_px: tuple[int, int] = (1, 1)
    ) -> Image:
        """Return the background: ``shape`` (rows, columns) points by ``step_px`` (u, v) from ``first_px``."""
        u = _powers(first_px[0] - self.middle_px[0], shape[1], step_px[0], self.scale_px)
        v = _powers(first_px[1] - self.middle_px[1], shape[0], step_px[1], self.scale_px)
        background: Image = v.T @ (self.by_power @ u)
        return background


@lru_cache(maxsize=256)
def _powers(first_px: float, count: int, step_px: int, scale_px: float) -> Image:
    """Return rows 1, x … x⁴ at ``count`` places; cached, since most frames have the same windows."""
    return np.vander((first_px + step_px * np.arange(count)) / scale_px, 5, increasing=True).T.astype(
        np.float32
    )


def coarse_image(pixels: PixelArray | Image) -> Image:
    """Return means over CELL_PX × CELL_PX cells, without single hot pixels.

    Halfway down, a 3 × 3 median removes anything smaller than about 8 px. Rows and columns that do not fill a
    cell are excluded: a spot there would be cut by the edge.

    The image is halved three times, since OpenCV has vector code only for halving. Single precision from the
    first half on keeps the fractions of a count: on whole numbers the median takes the nearest one.
    """
    rows, columns = pixels.shape[0] // CELL_PX, pixels.shape[1] // CELL_PX
    whole = pixels[: rows * CELL_PX, : columns * CELL_PX]
    # Reads the frame once from end to end, which is faster than the access to two rows at a time by
    # halving: on a frame that is not cached, it costs 10 µs and saves 30 µs.
    cv2.sumElems(whole)
    half = _halved(whole).astype(np.float32)
    half -= np.float32(_ROUNDING_BIAS_COUNTS)
    return _halved(cv2.medianBlur(_halved(half), 3))


def _halved(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return means over 2 × 2 pixels."""
    size = image.shape[1] // 2, image.shape[0] // 2
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def fit_background(coarse: Image) -> Background:
    """Fit the medians of 6 × 8 tiles by robust least squares; tiles that a light fills are outliers.

    The background is even or sloping light behind the fall-off of a lens, which depends on the square of the
    distance r from the middle: terms up to second degree, and r²u, r²v, r⁴.
    """
    rows, columns = coarse.shape
    tile_rows, tile_columns = min(_TILE_ROWS, rows), min(_TILE_COLUMNS, columns)
    height, width = rows // tile_rows, columns // tile_columns
    tiles = coarse[: height * tile_rows, : width * tile_columns]
    tiles = tiles.reshape(tile_rows, height, tile_columns, width).swapaxes(1, 2)
    values = median(tiles.reshape(tile_rows * tile_columns, -1)).astype(np.float64)
    middle_px = (columns * CELL_PX - 1) / 2, (rows * CELL_PX - 1) / 2
    scale_px = max(rows, columns) * CELL_PX / 2
    terms = 9 if coarse.size >= _MIN_CELLS_FOR_FALL_OFF else 6
    design = _tile_design(tile_rows, tile_columns, height, width, middle_px, scale_px)[:, :terms]
    middle = float(median(values))
    kept = values <= middle + _OUTLIER_SIGMAS * mad_sigma(np.abs(values - middle)) + 1.0
    solution: FloatArray = np.array([middle, *[0.0] * (terms - 1)])
    for _ in range(_MAX_ITERATIONS):
        if np.count_nonzero(kept) < len(values) // 3:
            break
        rows_kept = design[kept]
        # Normal equations take half the time of lstsq. The ridge is for tiles that leave a term undetermined.
        normal = rows_kept.T @ rows_kept + _RIDGE[:terms, :terms]
        solution = np.asarray(np.linalg.solve(normal, values[kept] @ rows_kept), dtype=np.float64)
        residuals = np.abs(values - design @ solution)
        limit = _OUTLIER_SIGMAS * mad_sigma(residuals[kept]) + _TOLERANCE_COUNTS
        kept_before, kept = kept, residuals <= limit
        if (kept == kept_before).all():
            break
    c, cu, cv, cuu, cuv, cvv, ru, rv, rr = solution.tolist() + [0.0] * (9 - terms)
    by_power = (
        (c, cu, cuu, ru, rr),
        (cv, cuv, rv, 0.0, 0.0),
        (cvv, ru, 2 * rr, 0.0, 0.0),
        (rv, 0.0, 0.0, 0.0, 0.0),
        (rr, 0.0, 0.0, 0.0, 0.0),
    )
    return Background(np.array(by_power, np.float32), middle_px, scale_px)


@lru_cache(maxsize=8)
def _tile_design(
    tile_rows: int,
    tile_columns: int,
    height: int,
    width: int,
    middle_px: tuple[float, float],
    scale_px: float,
) -> FloatArray:
    """Return rows of the background's terms at the tiles' middles."""
    along_u = (((np.arange(tile_columns) + 0.5) * width * CELL_PX - 0.5) - middle_px[0]) / scale_px
    along_v = (((np.arange(tile_rows) + 0.5) * height * CELL_PX - 0.5) - middle_px[1]) / scale_px
    u, v = (grid.ravel() for grid in np.meshgrid(along_u, along_v))
    r2 = u * u + v * v
    return np.column_stack([np.ones(u.size), u, v, u * u, u * v, v * v, r2 * u, r2 * v, r2 * r2])


def excess_over(coarse: Image, background: Background) -> Image:
    """Return the coarse image less the background, counts."""
    middle = (CELL_PX - 1) / 2
    return np.subtract(coarse, background.levels((middle, middle), coarse.shape, (CELL_PX, CELL_PX)))


def robust_sigma(values: Image) -> float:
    """Return the MAD-based standard deviation of values about zero; bright regions hardly count."""
    magnitudes = np.abs(values.ravel())
    middle = magnitudes.size // 2
    return MAD_TO_SIGMA * float(np.partition(magnitudes, middle)[middle])


def pixel_noise(pixels: PixelArray, background: Background) -> float:
    """Return the noise of one background pixel in counts, from a sparse sample of the frame.

    The MAD-based standard deviation only sets the limit up to which deviations are averaged, since on integer
    counts it moves in steps; 1/12 is the variance of rounding, the minimum of any camera.
    """
    step_v, step_u = max(pixels.shape[0] // 40, 1), max(pixels.shape[1] // 50, 1)
    sample = pixels[::step_v, ::step_u].astype(np.float32)
    sample -= background.levels((0.0, 0.0), sample.shape, (step_u, step_v))
    limit = 4.0 * (robust_sigma(sample) + 0.5)
    inner = sample[np.abs(sample) <= limit]
    return math.sqrt(float(inner @ inner) / inner.size + 1 / 12) if inner.size else limit


_DETECTION_SIGMAS = 8.0
_DETECTION_COUNTS = 1.5
_REGION_PEAK_SHARE = 0.1
_MIN_PEAK_SHARE = 0.4


@dataclass(frozen=True, slots=True)
class Region:
    """Bright region: window in px (right and bottom are exclusive), light and peak over background.

    ``light`` is the sum over coarse cells, ``peak`` the brightest cell, both in counts.
    """

    left: int
    top: int
    right: int
    bottom: int
    light: float
    peak: float


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """Result of the coarse search: the background and the bright regions, most light first."""

    background: Background
    regions: tuple[Region, ...]


def search(pixels: PixelArray) -> Search:
    """Find the bright regions of a frame that noise does not explain.

    A region's peak must exceed the coarse image's own noise by eight sigma (among 5 640 cells, four are
    usual) and be at least 0.4 of the brightest; the region extends to a tenth of the brightest.
    """
    coarse = coarse_image(pixels)
    background = fit_background(coarse)
    excess = excess_over(coarse, background)
    return _found(background, excess, max(_DETECTION_SIGMAS * robust_sigma(excess), _DETECTION_COUNTS))


def _found(background: Background, excess: Image, detection: float) -> Search:
    brightest = float(excess.max())
    if brightest < detection:
        return Search(background, ())
    regions = _regions(excess, max(detection / 2, _REGION_PEAK_SHARE * brightest))
    distinct = [region for region in regions if region.peak >= max(detection, _MIN_PEAK_SHARE * brightest)]
    return Search(background, tuple(sorted(distinct, key=lambda region: -region.light)))


_RING_RADII = 2.6, 5.0
"""Limits of the ring around a spot, in radii of its area above half its peak: a Gaussian has 1 % left."""
_MIN_RING_SHARE = 0.5
_MIN_UNEVEN_SHARE = 0.01
_MIN_WIDE_SHARE, _MIN_WIDE_RATIO = 0.06, 12.0
"""Minimum area of a region that may be a lamp's: in parts of the frame, where a spot of 17 mm takes 0.03; in
those of the brightest spot above half its peak, where a Gaussian takes 4."""


def search_around(pixels: PixelArray, found: Search) -> Search | None:
    """Find the brightest spot over the background of its own surroundings, such as a headlight's patch.

    The background is a polynomial of fourth degree, fitted to a ring around the spot. Returns None if that
    of ``found`` holds in the ring, or if too much of the ring is beyond the edge of the image.
    """
    coarse = coarse_image(pixels)
    excess = excess_over(coarse, found.background)
    _, brightest, _, at = cv2.minMaxLoc(excess)
    labels = cv2.connectedComponents((excess > brightest / 2).view(np.uint8))[1]
    rows, columns = np.nonzero(labels == labels[at[1], at[0]])
    inner, outer = (radii * math.sqrt(rows.size / math.pi) + 0.5 for radii in _RING_RADII)
    by_row, by_column = np.indices(coarse.shape)
    u, v = (by_column - columns.mean()) / outer, (by_row - rows.mean()) / outer
    distance = np.hypot(u, v)
    ring = (distance > inner / outer) & (distance <= 1)
    around = excess[ring]
    if around.size < _MIN_RING_SHARE * math.pi * (outer**2 - inner**2):
        return None
    first = found.regions[0]
    is_other = _area(first) > _MIN_WIDE_RATIO * CELL_PX**2 * rows.size
    if not (is_other if is_wide(first, pixels) else _rms(around) > _MIN_UNEVEN_SHARE * brightest):
        return None
    powers = [(of_v, of_u) for of_v in range(5) for of_u in range(5 - of_v)]
    terms = np.column_stack([v[ring] ** of_v * u[ring] ** of_u for of_v, of_u in powers])
    solution = np.linalg.lstsq(terms, coarse[ring], rcond=None)[0]
    by_power = np.zeros((5, 5), np.float32)
    for place, of_term in zip(powers, solution, strict=True):
        by_power[place] = of_term
    offset = (CELL_PX - 1) / 2
    middle_px = CELL_PX * float(columns.mean()) + offset, CELL_PX * float(rows.mean()) + offset
    own = Background(by_power, middle_px, outer * CELL_PX, _rms(coarse[ring] - terms @ solution))
    over_own = np.where(distance <= 1, excess_over(coarse, own), np.float32(0))
    return _found(own, over_own, max(_DETECTION_SIGMAS * own.uneven_counts, _DETECTION_COUNTS))


def is_wide(region: Region, pixels: PixelArray) -> bool:
    """Return whether a region of a frame is larger than any spot that is measured."""
    return _area(region) > _MIN_WIDE_SHARE * pixels.size


def _area(region: Region) -> int:
    return (region.right - region.left) * (region.bottom - region.top)


def _rms(values: npt.NDArray[Any]) -> float:
    return math.sqrt(float(values @ values) / values.size)


def _regions(excess: Image, level: float) -> list[Region]:
    # Grana's algorithm is three times as fast as OpenCV's choice on images so small. Statistics would
    # take three times as long as the labels.
    count, labels = cv2.connectedComponentsWithAlgorithm(
        (excess > level).view(np.uint8), 8, cv2.CV_32S, cv2.CCL_GRANA
    )
    return [_region(excess, np.asarray(labels) == label) for label in range(1, count)]


def _region(excess: Image, mask: npt.NDArray[np.bool_]) -> Region:
    left, top, width, height = cv2.boundingRect(mask.view(np.uint8))
    values = excess[mask]
    return Region(
        left=left * CELL_PX,
        top=top * CELL_PX,
        right=(left + width) * CELL_PX,
        bottom=(top + height) * CELL_PX,
        light=float(values.sum(dtype=np.float64)),
        peak=float(values.max()),
    )
