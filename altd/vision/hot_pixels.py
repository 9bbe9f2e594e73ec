"""The hot pixels of a sensor: single pixels that shine in every frame, and so tell one sensor from another.

What a lens images is wider than a pixel, so light does not look like this. A mirrored picture, one of another
part of the sensor and one of another sensor have them elsewhere; what stands before the lens changes nothing.
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
"""A sensor with more is kept with that many; of a picture with more it is not asked where they lie."""

_RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
_RATIO = 5
"""A hot pixel rises over the dimmest of its eight neighbours so many times as far as the brightest: in an
image as sharp as 0.5 px a glint does not. In even light the neighbours lie 2.8 sigma apart, so noise would
need 7 sigma."""
_ROUNDING_COUNTS = 3
_SPARSE = 9
"""The distance, in rows and columns, of the pixels that tell what is usual."""
_STRIP_PIXELS = 1 << 16
"""A frame is worked through in strips of about so many pixels: what is made of them stays cached. Memory
for the whole frame the kernel would hand out anew, page by page, for each frame: twice the time."""
_ALWAYS_SHARE = 0.9
_MIN_SOMETIMES_FRAMES = 2

_MIN_PRESENT = 3
"""That many in place by chance, of 20 at as many places in another sensor: once in 10^9."""
_MIN_EXPECTED = 4
_PRESENT_SHARE = 0.5
_ABSENT_SHARE = 0.15
_MAX_OFFSET_PX = 12
_MAX_LOST_PX = 400
_MIN_ASIDE = 3
"""By chance, of ten missing and ten foreign ones: once in 10^7."""


def hot_pixels(pixels: PixelArray) -> Places:
    """The hot pixels of a frame, row by row; those at its border are not looked for."""
    rows, columns = pixels.shape
    strip_rows = _SPARSE * max(_STRIP_PIXELS // columns // _SPARSE, 1)
    found, spreads = [], []
    for top in range(0, rows, strip_rows):
        first = max(top - 1, 0)  # with the neighbours above and below
        strip = pixels[first : top + strip_rows + 1]
        own = slice(top - first, top - first + strip_rows)
        brightest, dimmest = cv2.dilate(strip, _RING), cv2.erode(strip, _RING)
        spread = cv2.subtract(brightest[own][::_SPARSE, ::_SPARSE], dimmest[own][::_SPARSE, ::_SPARSE])
        spreads.append(np.asarray(spread))
        above = np.flatnonzero(cv2.subtract(strip, brightest)[own] > _ROUNDING_COUNTS)
        above += own.start * columns  # a few: the rest is cheap
        grey = (image.ravel()[above].astype(np.int64) for image in (strip, brightest, dimmest))
        found.append((above + first * columns, *grey))
    usual = int(np.median(np.concatenate(spreads)))
    above, here, high, low = (np.concatenate(parts) for parts in zip(*found, strict=True))
    above = above[here - low > _RATIO * np.maximum(high - low, usual) + _ROUNDING_COUNTS]
    v, u = np.divmod(above, columns)
    inside = (u > 0) & (v > 0) & (u < columns - 1) & (v < rows - 1)
    return np.asarray(np.stack([u, v], axis=1)[inside], dtype=np.int64)


@dataclass(frozen=True, slots=True)
class SensorMatch:
    """How a frame's hot pixels fit those of a calibration.

    ``expected`` of the calibration's could be seen, ``present`` of them are there, ``foreign`` are where the
    calibration has none. ``offset_px`` (u, v) is by how much the whole set lies elsewhere, where it does;
    ``aside`` of them lie the same number of pixels further on, and not in their places.
    """

    expected: int
    present: int
    foreign: int
    offset_px: tuple[int, int] | None
    aside: int = 0

    @property
    def is_same(self) -> bool:
        """Whether this is the sensor, read as it was."""
        return self.present >= max(_MIN_PRESENT, _PRESENT_SHARE * self.expected)

    @property
    def is_other(self) -> bool:
        """Whether this is another sensor, or another part or way of reading it.

        Hot pixels fade in the cold, so that they are missing is not enough: others must be there instead.
        """
        absent = self.expected >= _MIN_EXPECTED and self.present <= _ABSENT_SHARE * self.expected
        return (absent and self.foreign >= max(_MIN_PRESENT, self.expected / 4)) or self.is_shifted_partly

    @property
    def is_shifted_partly(self) -> bool:
        """Whether a part of the picture lies aside, as where bytes were lost on the way."""
        most = self.present + self.aside >= _PRESENT_SHARE * self.expected
        return most and self.aside >= max(_MIN_ASIDE, _ABSENT_SHARE * self.expected)


@dataclass(frozen=True, eq=False)
class HotPixels:
    """A sensor's hot pixels: ``always`` (n, 2) in every frame, ``sometimes`` (m, 2) in some."""

    always: Places
    sometimes: Places

    def compare(self, pixels: PixelArray) -> SensorMatch:
        """Hold a frame against them."""
        seen = hot_pixels(pixels)
        known, now = self._always_set, _as_set(seen)
        present = len(known & now)
        foreign = len(now - known - self._sometimes_set)
        expected = len(known) - self._hidden(pixels, known - now)
        aside = _aside(known - now, now - known, pixels.shape[1])
        return SensorMatch(expected, present, foreign, self._offset_px(seen, present), aside)

    @cached_property
    def _always_set(self) -> set[tuple[int, int]]:
        return _as_set(self.always)

    @cached_property
    def _sometimes_set(self) -> set[tuple[int, int]]:
        return _as_set(self.sometimes)

    def _hidden(self, pixels: PixelArray, missing: set[tuple[int, int]]) -> int:
        """How many of the missing ones light drowns: their neighbours are brighter than most of the frame."""
        if not missing:
            return 0
        ordinary = float(np.percentile(pixels[::9, ::9], 90)) + _ROUNDING_COUNTS
        rows, columns = pixels.shape
        return sum(
            not (1 <= u < columns - 1 and 1 <= v < rows - 1)
            or float(np.median(pixels[v - 1 : v + 2, u - 1 : u + 2])) > ordinary
            for u, v in missing
        )

    def _offset_px(self, seen: Places, present: int) -> tuple[int, int] | None:
        """Where most of the hot pixels lie the same way beside their places, if not in them."""
        if not 0 < len(seen) <= MAX_PIXELS or present == len(self.always):
            return None
        offsets = (seen[:, None, :] - self.always[None, :, :]).reshape(-1, 2)
        near = offsets[np.abs(offsets).max(axis=1) <= _MAX_OFFSET_PX]
        if not len(near):
            return None
        steps, counts = np.unique(near, axis=0, return_counts=True)
        best = int(counts.argmax())
        if counts[best] < max(_MIN_PRESENT, _PRESENT_SHARE * len(self.always)) or counts[best] <= present:
            return None
        return int(steps[best, 0]), int(steps[best, 1])


class HotPixelCount:
    """Counts in how many frames of one camera each pixel is hot."""

    def __init__(self) -> None:
        self._frames = 0
        self._hot: dict[tuple[int, int], int] = {}

    def add(self, pixels: PixelArray) -> None:
        """Count one frame."""
        self._frames += 1
        for place in _as_set(hot_pixels(pixels)):
            self._hot[place] = self._hot.get(place, 0) + 1

    def result(self) -> HotPixels:
        """What was counted so far; single flashes are left out."""
        often = sorted(self._hot.items(), key=lambda item: -item[1])[:MAX_PIXELS]
        always = [place for place, count in often if count >= _ALWAYS_SHARE * self._frames]
        sometimes = [place for place, count in often[len(always) :] if count >= _MIN_SOMETIMES_FRAMES]
        return HotPixels(places_of(always), places_of(sometimes))


def places_of(places: list[tuple[int, int]]) -> Places:
    """Pixels (n, 2) from pairs."""
    return np.array(sorted(places), dtype=np.int64).reshape(-1, 2)


def _aside(missing: set[tuple[int, int]], foreign: set[tuple[int, int]], width_px: int) -> int:
    """How many of the missing ones lie the same number of pixels further on, or back, as rows follow."""
    if not missing or not 0 < len(foreign) <= MAX_PIXELS:
        return 0
    here, there = (np.array([v * width_px + u for u, v in places]) for places in (missing, foreign))
    offsets = (there[:, None] - here[None, :]).ravel()
    near = offsets[np.abs(offsets) <= _MAX_LOST_PX] + _MAX_LOST_PX
    return int(np.bincount(near).max()) if near.size else 0


def _as_set(places: Places) -> set[tuple[int, int]]:
    return {(int(u), int(v)) for u, v in places}
