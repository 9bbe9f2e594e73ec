"""Exposures of a flat made with the laser: the lit pixels and the laser's power in each exposure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

from altd.calibration.printed.sample import PolynomialInverse
from altd.mapping.tensor_map import TensorMap
from altd.recording.reader import Recording
from altd.records import FloatArray
from altd.vision.image import Image

_BINS = 49
"""Number of bins of the spot's table along each axis, over two of its 1/e² diameters."""


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """The part of an exposure that the spot reaches, and its pixels' places in the spot's table."""

    position_mm: tuple[float, float]
    pixels: Image
    window: tuple[slice, slice]
    is_whole: bool
    along_x: Image
    along_y: Image

    def irradiance(self, spot: Image) -> Image:
        """Irradiance of a spot at the pixels; 0 outside its table."""
        return np.asarray(cv2.remap(spot, self.along_x, self.along_y, cv2.INTER_LINEAR))


@dataclass(slots=True, eq=False)
class SpotSums:
    """Summed light and number of pixels in each bin of the spot's table."""

    light: FloatArray = field(default_factory=lambda: np.zeros(_BINS * _BINS))
    pixels: FloatArray = field(default_factory=lambda: np.zeros(_BINS * _BINS))

    def add(self, shot: Shot) -> None:
        """Add the pixels of an exposure."""
        inside = (np.minimum(shot.along_x, shot.along_y) > -0.5) & (
            np.maximum(shot.along_x, shot.along_y) < _BINS - 0.5
        )
        bins = np.rint(shot.along_y[inside]).astype(np.intp) * _BINS
        bins += np.rint(shot.along_x[inside]).astype(np.intp)
        self.light += np.bincount(bins, shot.pixels[inside], _BINS * _BINS)
        self.pixels += np.bincount(bins, minlength=_BINS * _BINS)

    @property
    def spot(self) -> tuple[Image, float]:
        """The table, 1 at the peak and 0 at its rim, and the peak in counts."""
        spot = (self.light / np.maximum(self.pixels, 1)).reshape(_BINS, _BINS)
        spot -= np.median(np.concatenate([spot[0], spot[-1], spot[:, 0], spot[:, -1]]))
        peak = max(float(spot.max()), 1e-9)
        return np.maximum(spot / peak, 0).astype(np.float32), peak


class Exposures:
    """The exposures of one camera; each pass reads them again, and none is kept."""

    def __init__(self, recording: Recording, camera: str, first_map: TensorMap, diameter_mm: float) -> None:
        header = recording.header.cameras[camera]
        self.shape = header.height, header.width
        self.full_scale = (1 << header.bits) - 1
        self._recording = recording
        self._camera = camera
        self.diameter_mm = diameter_mm
        self._to_px = first_map.to_px
        picture_mm = PolynomialInverse(first_map).grid_mm(*self.shape).astype(np.float32)
        self.x_mm, self.y_mm = (np.ascontiguousarray(picture_mm[..., axis]) for axis in (0, 1))
        around = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        self._circle_mm = diameter_mm * np.column_stack([np.cos(around), np.sin(around)])
        self._bins_per_mm = np.float32((_BINS - 1) / 2 / diameter_mm)

    def __iter__(self) -> Iterator[tuple[Image, Shot | None]]:
        """Yield each picture and the part that the spot reaches; None if the laser is off or beside it."""
        for row in self._recording.rows.of(self._camera):
            if not row.leds_on:
                pixels = self._recording.frame(row).pixels.astype(np.float32)
                yield pixels, None if row.position_mm is None else self._shot(pixels, row.position_mm)

    def _shot(self, pixels: Image, position_mm: tuple[float, float]) -> Shot | None:
        circle_px = self._to_px(self._circle_mm + position_mm)
        left, top = np.floor(circle_px.min(axis=0)).astype(int).tolist()
        right, bottom = np.ceil(circle_px.max(axis=0)).astype(int).tolist()
        rows, columns = self.shape
        window = slice(max(top, 0), min(bottom, rows)), slice(max(left, 0), min(right, columns))
        part = pixels[window]
        if not part.size:
            return None
        middle = np.float32((_BINS - 1) / 2)
        return Shot(
            position_mm,
            part,
            window,
            part.shape == (bottom - top, right - left),
            (self.x_mm[window] - np.float32(position_mm[0])) * self._bins_per_mm + middle,
            (self.y_mm[window] - np.float32(position_mm[1])) * self._bins_per_mm + middle,
        )


_CELLS_PER_DIAMETER = 12
_MIN_WEIGHT = 1e-3
_MIN_PRIOR = 0.02
"""Minimum error variance of r over the prior variance of a: second-order errors, as of the first map."""
_MAX_STEPS = 300
_CONVERGED = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Positions on a grid of square cells; the four nearest cell centres share a value."""

    shape: tuple[int, int]
    corners: npt.NDArray[np.intp]
    shares: FloatArray

    @classmethod
    def of(cls, positions_mm: FloatArray, cell_mm: float, rim: int) -> _Cells:
        """Build the cells of positions (n, 2), with ``rim`` cells around."""
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
        """Distribute values (n,) at the positions over the grid."""
        cells = math.prod(self.shape)
        sums = np.bincount(self.corners.ravel(), (self.shares * values).ravel(), cells)
        return sums.reshape(self.shape).astype(np.float64)

    def gathered(self, field: FloatArray) -> FloatArray:
        """Interpolate a field of the grid at the positions, (n,)."""
        values: FloatArray = (field.ravel()[self.corners] * self.shares).sum(axis=0)
        return values


def true_excess(
    positions_mm: FloatArray, seen: FloatArray, noise: FloatArray, weights: Image, diameter_mm: float
) -> FloatArray:
    """Estimate the excess power a (n,) of exposures at positions (n, 2) from the ``seen`` excess r.

    The seen excess results from a response that assumed constant power. Where spots overlap, the response
    contains part of an exposure's excess, so the excess seems smaller: r = a − G a, with a_k the true excess
    of exposure k. G is a mean over neighbours: the excess is spread about each p_k with the weights of the
    spot, divided by their sum, and gathered with the same weights. G follows from the positions alone, so
    a = (1 − G)⁻¹ r takes no further pass over the frames. Excess that is smooth over the raster hardly
    appears in r; there the prior decides, in favour of constant power.

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
