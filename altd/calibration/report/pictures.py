"""The scan in one picture a camera: every node's spot and the frame LEDs, as the camera saw them."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from altd.recording.reader import Recording
from altd.records import PixelArray

_WIDEST_PX = 480
"""More would make the page large and nothing clearer."""


def scan_negatives(recording: Recording) -> Mapping[str, PixelArray]:
    """The brightest of what each camera saw at each pixel, as a negative, (rows, columns) uint8 per camera.

    Of each node one exposure counts, of the LED reference those with LEDs on; large pictures are made small.
    Raises BadInputError for a frame that cannot be decoded.
    """
    brightest: dict[str, PixelArray] = {}
    taken: set[tuple[str, tuple[float, float]]] = set()
    for row in recording.rows:
        if row.position_mm is not None:
            place = (row.camera, row.position_mm)
            if place in taken:
                continue
            taken.add(place)
        elif not row.leds_on:
            continue
        pixels = recording.frame(row).pixels
        known = brightest.get(row.camera)
        brightest[row.camera] = pixels if known is None else np.maximum(known, pixels)
    return {camera: _negative(pixels) for camera, pixels in brightest.items()}


def _negative(pixels: PixelArray) -> PixelArray:
    """Light on dark becomes dark on light; the square root shows what is dim."""
    width = min(_WIDEST_PX, pixels.shape[1])
    height = max(1, round(pixels.shape[0] * width / pixels.shape[1]))
    light = cv2.resize(pixels.astype(np.float64), (width, height), interpolation=cv2.INTER_AREA)
    dark, bright = float(np.median(light)), float(light.max())
    share = np.clip((light - dark) / max(bright - dark, 1.0), 0.0, 1.0)
    negative: PixelArray = np.rint(255 * (1 - np.sqrt(share))).astype(np.uint8)
    return negative
