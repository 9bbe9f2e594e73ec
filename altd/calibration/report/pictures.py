"""The scan in one picture a target: every node's spot and the frame LEDs, as the camera saw them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import cv2
import numpy as np

from altd.calibration.target_frames import FrameRow, TargetFrames
from altd.records import PixelArray

_MAX_WIDTH_PX = 480
"""More would make the page large and nothing clearer."""


def scan_negatives(targets: Sequence[TargetFrames]) -> Mapping[str, PixelArray]:
    """The brightest of what a target's camera saw at each pixel, as a negative, (rows, columns) uint8.

    By the targets' names. Of each node one exposure counts, of the LED reference those with LEDs on; large
    pictures are made small. Raises BadInputError for a frame that cannot be decoded.
    """
    brightest = {frames.name: _brightest(frames) for frames in targets}
    return {name: _negative(pixels) for name, pixels in brightest.items() if pixels is not None}


def _brightest(frames: Iterable[FrameRow]) -> PixelArray | None:
    brightest: PixelArray | None = None
    taken: set[tuple[float, float]] = set()
    for frame_row in frames:
        position_mm = frame_row.row.position_mm
        if position_mm in taken or (position_mm is None and not frame_row.row.leds_on):
            continue
        if position_mm is not None:
            taken.add(position_mm)
        pixels = frame_row.frame().pixels
        brightest = pixels if brightest is None else np.maximum(brightest, pixels)
    return brightest


def _negative(pixels: PixelArray) -> PixelArray:
    """Light on dark becomes dark on light; the square root shows what is dim."""
    width = min(_MAX_WIDTH_PX, pixels.shape[1])
    height = max(1, round(pixels.shape[0] * width / pixels.shape[1]))
    light = cv2.resize(pixels.astype(np.float64), (width, height), interpolation=cv2.INTER_AREA)
    dark, bright = float(np.median(light)), float(light.max())
    share = np.clip((light - dark) / max(bright - dark, 1.0), 0.0, 1.0)
    negative: PixelArray = np.rint(255 * (1 - np.sqrt(share))).astype(np.uint8)
    return negative
