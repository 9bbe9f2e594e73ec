"""Frames with their true spots, and what a library that leaves it to its user is given of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, cast

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import Frame, PixelArray
from altd.vision.flat import Flat
from altd.vision.search import Region, Search, search
from hw_sim.beam import BeamPose
from hw_sim.flat import EVEN_MW_PER_MM2
from hw_sim.sensor import READ_NOISE_E
from hw_sim.unit import CAMERAS, EXPOSURES_MS, FRONT, REAR, Unit, UnitConfig
from hw_sim.view import View

WINDOW, PLATE, CLEAN = "dot window", "plate", "clean"
KINDS = (WINDOW, PLATE, CLEAN)

FIRST_SEED = 111
"""Units that no setting of altd was chosen on, and none of a peer's: that was on 101 and 102."""

SMOOTHING_PX = 4.0
"""Sigma of the Gaussian that bridges the printed dots, altd's own: it is given to all who threshold."""

_HALF_AREA_MM = (55.0, 42.0)
_MARGIN_OF_REGION = 0.5
"""By this share of its longer side a region is widened all round: to about twice the 1/e² radius."""


_FLAT_EXPOSURES = 20
"""In even light and in the dark, as ``hw_sim flat`` takes them."""


@dataclass(frozen=True, slots=True, eq=False)
class FlatField:
    """What each pixel of a camera shows of even light, (rows, columns) of mean 1, as measured.

    ``for_altd`` is the same with what altd keeps of it; ``smooth_square`` is the square of ``response`` after
    the smoothing of ``SMOOTHING_PX``.
    """

    response: npt.NDArray[np.float32]
    for_altd: Flat
    smooth_square: npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Sample:
    """A frame of unit ``seed``, its true spot, and what may be given instead of the frame itself.

    ``mended`` is the frame with the camera's hot pixels, known from its simulation, replaced by a median;
    ``mended_excess`` is that without the background that altd finds, in counts; ``excess`` is the part of it
    around the spot, from row ``top`` and column ``left`` on. ``flat`` is the frame's flat field.
    """

    seed: int
    kind: str
    frame: Frame
    truth_px: tuple[float, float]
    found: Search
    region: Region
    mended: PixelArray
    left: int
    top: int
    excess: npt.NDArray[np.float32]
    mended_excess: npt.NDArray[np.float32]
    flat: FlatField

    @property
    def raw(self) -> PixelArray:
        """The region of ``mended``, background and all."""
        return self.mended[self.window]

    @property
    def window(self) -> tuple[slice, slice]:
        """The region's rows and columns in the frame."""
        rows, columns = self.excess.shape
        return slice(self.top, self.top + rows), slice(self.left, self.left + columns)


def make_samples(units: int, poses: int) -> Iterator[Sample]:
    """``units`` units as they are and the same without print, speckle and hot pixels, ``poses`` each."""
    for seed in range(FIRST_SEED, FIRST_SEED + units):
        yield from _of_unit(UnitConfig(seed=seed), {FRONT: WINDOW, REAR: PLATE}, poses)
        clean = UnitConfig(seed=seed, speckle_contrast=0.0, hot_pixels=0, dots=None)
        yield from _of_unit(clean, {FRONT: CLEAN, REAR: CLEAN}, poses)


def _of_unit(config: UnitConfig, kinds: dict[str, str], poses: int) -> Iterator[Sample]:
    unit = Unit(config)
    rng = np.random.default_rng([config.seed, 1])
    flats = {camera: _flat(unit.imagers[camera].view, EXPOSURES_MS[camera], rng) for camera in CAMERAS}
    for sequence in range(poses):
        at_front, at_rear = rng.uniform(-1.0, 1.0, (2, 2)) * _HALF_AREA_MM
        slopes = (at_rear - at_front) / config.target_distance_mm
        pose = BeamPose(float(at_front[0]), float(at_front[1]), float(slopes[0]), float(slopes[1]))
        unit.place(pose)
        for camera in CAMERAS:
            frame = unit.expose(camera, sequence, sequence * config.period_ns, exact=True)
            view = unit.imagers[camera].view
            u, v = view.lens.project(*pose.at(0.0 if camera == FRONT else config.target_distance_mm))
            yield _sample(config.seed, kinds[camera], frame, (float(u), float(v)), view, flats[camera])


def _flat(view: View, exposure_ms: float, rng: np.random.Generator) -> FlatField:
    """The mean of exposures of an evenly lit target less that of dark ones, with shot and read noise."""
    mean_e = view.response * np.float32(EVEN_MW_PER_MM2 * exposure_ms)
    noise_e = np.sqrt((mean_e + np.float32(2 * READ_NOISE_E**2)) / np.float32(_FLAT_EXPOSURES))
    seen = mean_e + noise_e * rng.standard_normal(mean_e.shape, dtype=np.float32)
    response = seen / np.float32(seen.mean())
    flat = Flat.of(response, "recording")
    _ = flat.blocks  # kept by the flat, as by a daemon that runs
    return FlatField(response, flat, np.asarray(cv2.GaussianBlur(response**2, (0, 0), SMOOTHING_PX)))


def _sample(
    seed: int, kind: str, frame: Frame, truth_px: tuple[float, float], view: View, flat: FlatField
) -> Sample:
    found = search(frame.pixels)
    region = found.regions[0]
    mended = frame.pixels.copy()
    hot = view.hot_e > 0
    mended[hot] = cv2.medianBlur(cast("Any", frame.pixels), 5)[hot]
    margin = math.ceil(_MARGIN_OF_REGION * max(region.right - region.left, region.bottom - region.top))
    rows, columns = mended.shape
    left, top = max(region.left - margin, 0), max(region.top - margin, 0)
    right, bottom = min(region.right + margin, columns), min(region.bottom + margin, rows)
    whole = mended.astype(np.float32)
    whole -= found.background.at((0.0, 0.0), whole.shape)
    box = whole[top:bottom, left:right].copy()
    return Sample(seed, kind, frame, truth_px, found, region, mended, left, top, box, whole, flat)
