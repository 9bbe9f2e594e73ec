"""The exposures of a flat made with the laser: which pixels each lights, and their places in the spot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np

from altd.calibration.printed.sample import Plane
from altd.mapping.tensor_map import TensorMap
from altd.recording.reader import Recording
from altd.records import FloatArray
from altd.vision.image import Image

_BINS = 49
"""Of the table of the spot along each axis, over two of its 1/e² diameters."""


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """The part of an exposure that the spot reaches; where its pixels are in the table of the spot."""

    position_mm: tuple[float, float]
    pixels: Image
    window: tuple[slice, slice]
    is_whole: bool
    along_x: Image
    along_y: Image

    def irradiance(self, spot: Image) -> Image:
        """That of a spot at the pixels; 0 outside of its table."""
        return np.asarray(cv2.remap(spot, self.along_x, self.along_y, cv2.INTER_LINEAR))


@dataclass(slots=True, eq=False)
class SpotSums:
    """Light and number of the pixels in the bins of the spot's table."""

    light: FloatArray = field(default_factory=lambda: np.zeros(_BINS * _BINS))
    pixels: FloatArray = field(default_factory=lambda: np.zeros(_BINS * _BINS))

    def add(self, shot: Shot) -> None:
        """Take in the pixels of an exposure."""
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


class Raster:
    """The exposures of one camera; they are read again in each pass, and none is kept."""

    def __init__(self, recording: Recording, camera: str, first_map: TensorMap, diameter_mm: float) -> None:
        header = recording.header.cameras[camera]
        self.shape = header.height, header.width
        self.full_scale = (1 << header.bits) - 1
        self._recording = recording
        self._camera = camera
        self.diameter_mm = diameter_mm
        self._to_px = first_map.to_px
        picture_mm = Plane(first_map).grid_mm(*self.shape).astype(np.float32)
        self.x_mm, self.y_mm = (np.ascontiguousarray(picture_mm[..., axis]) for axis in (0, 1))
        around = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        self._circle_mm = diameter_mm * np.column_stack([np.cos(around), np.sin(around)])
        self._bins_per_mm = np.float32((_BINS - 1) / 2 / diameter_mm)

    def __iter__(self) -> Iterator[tuple[Image, Shot | None]]:
        """Each picture, and the part that the spot reaches; None: the laser is off or shines beside it."""
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
