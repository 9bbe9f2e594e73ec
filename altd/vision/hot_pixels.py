"""Hot pixels of a sensor: single pixels that are bright in every frame, and so identify the sensor.

A lens images light wider than a pixel, so light is not taken for them. A mirrored image, one of another part
of the sensor and one of another sensor have them elsewhere; the scene before the lens has no effect.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import PixelArray

Places = npt.NDArray[np.int64]
"""Pixels (n, 2) as u, v."""

MAX_PIXELS = 500
"""Maximum number of hot pixels kept of a sensor; in an image with more, no offset is searched."""

_NEIGHBOURS = tuple((dv, du) for dv in (-1, 0, 1) for du in (-1, 0, 1) if dv or du)
_MIN_RISE_RATIO = 5
"""Minimum rise of a hot pixel over the dimmest of its eight neighbours, relative to that of the brightest: a
glint rises less, even in an image as sharp as 0.5 px. In even light the neighbours are 2.8 sigma apart, so
noise would need 7 sigma."""
_ROUNDING_COUNTS = 3
_SPARSE = 9
"""Distance, in rows and columns, of the pixels whose neighbourhoods are sampled."""
_PIECE_PIXELS = 1 << 16
"""Number of pixels of a frame processed at once, so that intermediate results stay cached. For those of the
whole frame the kernel would provide memory again, page by page, for each frame."""
_MIN_PERMANENT_SHARE = 0.9
_MIN_INTERMITTENT_FRAMES = 2

_MIN_PRESENT = 3
"""Minimum number of matches; for another sensor with 20 hot pixels, this many of 20 match once in 10^9."""
_MIN_EXPECTED = 4
_MIN_PRESENT_SHARE = 0.5
_MAX_CHANCE_SHARE = 0.15
"""Maximum share of a calibration's hot pixels that may coincide by chance."""
_MAX_OFFSET_PX = 12
_MAX_DISPLACEMENT_PX = 400
_MIN_DISPLACED = 3
"""Minimum number equally displaced; by chance, of ten missing and ten foreign ones: once in 10^7."""


def hot_pixels(pixels: PixelArray) -> Places:
    """Return the hot pixels of a frame, row by row; those at its border are not searched."""
    rows, columns = pixels.shape
    if min(rows, columns) < 3:
        return places_of([])
    median_range = _median_range(pixels)
    # A hot pixel fulfils here - low > 5 max(high - low, median) + 3, so here - high > 4 median + 3, too.
    # high is at least the brighter of left and right: this test is the cheapest and leaves few candidates.
    least_rise = (_MIN_RISE_RATIO - 1) * median_range + _ROUNDING_COUNTS
    flat, found = pixels.ravel(), []
    end = flat.size - columns
    for first in range(columns, end, _PIECE_PIXELS):
        last = min(first + _PIECE_PIXELS, end)
        beside = np.maximum(flat[first - 1 : last - 1], flat[first + 1 : last + 1])
        rise = np.asarray(cv2.subtract(flat[first:last], beside)).ravel()  # at least 0
        found.append((rise > least_rise).nonzero()[0] + first)
    candidates = np.concatenate(found)
    column = candidates % columns
    candidates = candidates[(column > 0) & (column < columns - 1)]
    steps = np.array([dv * columns + du for dv, du in _NEIGHBOURS])
    here, around = flat[candidates].astype(np.int64), flat[candidates[:, None] + steps].astype(np.int64)
    high, low = around.max(axis=1), around.min(axis=1)
    is_hot = here - low > _MIN_RISE_RATIO * np.maximum(high - low, median_range) + _ROUNDING_COUNTS
    v, u = np.divmod(candidates[is_hot], columns)
    return np.asarray(np.stack([u, v], axis=1), dtype=np.int64)


def _median_range(pixels: PixelArray) -> int:
    """Return the median of a sample of the ranges from the dimmest to the brightest of eight neighbours."""
    rows, columns = pixels.shape
    v = np.arange(0, rows, _SPARSE)
    # Mirrored at the border, where a pixel has fewer neighbours: this repeats them and adds no others.
    above, within, below = (
        cv2.copyMakeBorder(pixels[at], 0, 0, 1, 1, cv2.BORDER_REFLECT_101)
        for at in (abs(v - 1), v, np.where(v + 1 < rows, v + 1, v - 1))
    )
    left, middle, right = (slice(first, first + columns, _SPARSE) for first in range(3))

    def extreme(of_two: np.ufunc) -> PixelArray:
        outer = of_two(above, below)
        whole = of_two(outer, within)
        most: PixelArray = of_two(of_two(whole[:, left], whole[:, right]), outer[:, middle])
        return most

    return int(np.median(extreme(np.maximum) - extreme(np.minimum)))


@dataclass(frozen=True, slots=True)
class SensorMatch:
    """Agreement of a frame's hot pixels with those of a calibration.

    ``expected`` of the calibration's could be visible, ``present`` of them are there, ``foreign`` are in
    places where the calibration has none. ``offset_px`` (u, v) is the displacement of the whole set, if there
    is one; ``displaced`` of them are the same number of pixels further on, and not in their places.
    """

    expected: int
    present: int
    foreign: int
    offset_px: tuple[int, int] | None
    displaced: int = 0

    @property
    def is_same(self) -> bool:
        """Whether this is the calibrated sensor with the same readout."""
        return self.present >= max(_MIN_PRESENT, _MIN_PRESENT_SHARE * self.expected)

    @property
    def is_other(self) -> bool:
        """Whether this is another sensor, or another part or readout of it.

        Hot pixels fade in the cold, so missing ones are not enough: others must be present instead.
        """
        absent = self.expected >= _MIN_EXPECTED and self.present <= _MAX_CHANCE_SHARE * self.expected
        return (absent and self.foreign >= max(_MIN_PRESENT, self.expected / 4)) or self.is_shifted_partly

    @property
    def is_shifted_partly(self) -> bool:
        """Whether a part of the image is displaced, as after bytes were lost in transmission."""
        most = self.present + self.displaced >= _MIN_PRESENT_SHARE * self.expected
        return most and self.displaced >= max(_MIN_DISPLACED, _MAX_CHANCE_SHARE * self.expected)


@dataclass(frozen=True, eq=False)
class HotPixels:
    """Hot pixels of a sensor: ``permanent`` (n, 2) in every frame, ``intermittent`` (m, 2) in some."""

    permanent: Places
    intermittent: Places

    def compare(self, pixels: PixelArray) -> SensorMatch:
        """Compare the hot pixels of a frame with these."""
        seen = hot_pixels(pixels)
        known, now = self._permanent_set, _as_set(seen)
        present = len(known & now)
        foreign = len(now - known - self._intermittent_set)
        expected = len(known) - self._count_hidden(pixels, known - now)
        displaced = _displaced_along_rows(known - now, now - known, pixels.shape[1])
        return SensorMatch(expected, present, foreign, self._offset_px(seen, present), displaced)

    @cached_property
    def _permanent_set(self) -> set[tuple[int, int]]:
        return _as_set(self.permanent)

    @cached_property
    def _intermittent_set(self) -> set[tuple[int, int]]:
        return _as_set(self.intermittent)

    def _count_hidden(self, pixels: PixelArray, missing: set[tuple[int, int]]) -> int:
        """Return the number of missing ones hidden by light: neighbours brighter than most of the frame."""
        if not missing:
            return 0
        background = float(np.percentile(pixels[::9, ::9], 90)) + _ROUNDING_COUNTS
        rows, columns = pixels.shape
        return sum(
            not (1 <= u < columns - 1 and 1 <= v < rows - 1)
            or float(np.median(pixels[v - 1 : v + 2, u - 1 : u + 2])) > background
            for u, v in missing
        )

    def _offset_px(self, seen: Places, present: int) -> tuple[int, int] | None:
        """Return the offset of most of the hot pixels, if it is not 0; None if there is none."""
        if not 0 < len(seen) <= MAX_PIXELS or present == len(self.permanent):
            return None
        offsets = (seen[:, None, :] - self.permanent[None, :, :]).reshape(-1, 2)
        near = offsets[np.abs(offsets).max(axis=1) <= _MAX_OFFSET_PX]
        if not len(near):
            return None
        steps, counts = np.unique(near, axis=0, return_counts=True)
        best = int(counts.argmax())
        at_least = max(_MIN_PRESENT, _MIN_PRESENT_SHARE * len(self.permanent), present + 1)
        if counts[best] < at_least:
            return None
        return int(steps[best, 0]), int(steps[best, 1])


class HotPixelCount:
    """Counts in how many frames of one camera each pixel is hot."""

    def __init__(self) -> None:
        self._frames = 0
        self._hot: dict[tuple[int, int], int] = {}

    def add(self, pixels: PixelArray) -> None:
        """Count the hot pixels of one frame."""
        self._frames += 1
        for place in _as_set(hot_pixels(pixels)):
            self._hot[place] = self._hot.get(place, 0) + 1

    def result(self) -> HotPixels:
        """Return the hot pixels counted so far, without those of a single frame."""
        by_count = sorted(self._hot.items(), key=lambda item: -item[1])[:MAX_PIXELS]
        permanent = [place for place, count in by_count if count >= _MIN_PERMANENT_SHARE * self._frames]
        intermittent = [
            place for place, count in by_count[len(permanent) :] if count >= _MIN_INTERMITTENT_FRAMES
        ]
        return HotPixels(places_of(permanent), places_of(intermittent))


def places_of(places: list[tuple[int, int]]) -> Places:
    """Return pixels (n, 2) from pairs."""
    return np.array(sorted(places), dtype=np.int64).reshape(-1, 2)


def _displaced_along_rows(missing: set[tuple[int, int]], foreign: set[tuple[int, int]], width_px: int) -> int:
    """Return how many missing ones are the same number of pixels further on, or back, in row order."""
    if not missing or not 0 < len(foreign) <= MAX_PIXELS:
        return 0
    here, there = (np.array([v * width_px + u for u, v in places]) for places in (missing, foreign))
    offsets = (there[:, None] - here[None, :]).ravel()
    near = offsets[np.abs(offsets) <= _MAX_DISPLACEMENT_PX] + _MAX_DISPLACEMENT_PX
    return int(np.bincount(near).max()) if near.size else 0


def _as_set(places: Places) -> set[tuple[int, int]]:
    return {(int(u), int(v)) for u, v in places}
