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
from altd.vision.search import Region, Search, search
from hw_sim.beam import BeamPose
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig
from hw_sim.view import View

WINDOW, PLATE, CLEAN = "dot window", "plate", "clean"
KINDS = (WINDOW, PLATE, CLEAN)

FIRST_SEED = 111
"""Units that no setting of altd was chosen on, and none of a peer's: that was on 101 and 102."""

_HALF_AREA_MM = (55.0, 42.0)
_MARGIN_OF_REGION = 0.5
"""By this share of its longer side a region is widened all round: to about twice the 1/e² radius."""


@dataclass(frozen=True, slots=True)
class Sample:
    """A frame of unit ``seed``, its true spot, and what may be given instead of the frame itself.

    ``mended`` is the frame with the camera's hot pixels, known from its simulation, replaced by a median;
    ``mended_excess`` is that without the background that altd finds, in counts; ``excess`` is the part of it
    around the spot, from row ``top`` and column ``left`` on.
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

    @property
    def raw(self) -> PixelArray:
        """The box of ``mended``, background and all."""
        rows, columns = self.excess.shape
        return self.mended[self.top : self.top + rows, self.left : self.left + columns]


def make_samples(units: int, poses: int) -> Iterator[Sample]:
    """``units`` units as they are and the same without print, speckle and hot pixels, ``poses`` each."""
    for seed in range(FIRST_SEED, FIRST_SEED + units):
        yield from _of_unit(UnitConfig(seed=seed), {FRONT: WINDOW, REAR: PLATE}, poses)
        clean = UnitConfig(seed=seed, speckle_contrast=0.0, hot_pixels=0, dots=False)
        yield from _of_unit(clean, {FRONT: CLEAN, REAR: CLEAN}, poses)


def _of_unit(config: UnitConfig, kinds: dict[str, str], poses: int) -> Iterator[Sample]:
    unit = Unit(config)
    rng = np.random.default_rng([config.seed, 1])
    for sequence in range(poses):
        at_front, at_rear = rng.uniform(-1.0, 1.0, (2, 2)) * _HALF_AREA_MM
        slopes = (at_rear - at_front) / config.target_distance_mm
        pose = BeamPose(float(at_front[0]), float(at_front[1]), float(slopes[0]), float(slopes[1]))
        unit.place(pose)
        for camera in CAMERAS:
            frame = unit.expose(camera, sequence, sequence * config.period_ns, exact=True)
            view = unit.eyes[camera].view
            u, v = view.lens.project(*pose.at(0.0 if camera == FRONT else config.target_distance_mm))
            yield _sample(config.seed, kinds[camera], frame, (float(u), float(v)), view)


def _sample(seed: int, kind: str, frame: Frame, truth_px: tuple[float, float], view: View) -> Sample:
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
    whole -= found.background.at(np.arange(columns, dtype=float), np.arange(rows, dtype=float))
    box = whole[top:bottom, left:right].copy()
    return Sample(seed, kind, frame, truth_px, found, region, mended, left, top, box, whole)
