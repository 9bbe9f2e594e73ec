"""Basic types of localisation: images in single precision, the noise of their pixels, and the centre."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import PixelArray

SATURATED_FROM = 0.995
"""Share of full scale from which a pixel counts as saturated."""
_MIN_PLATEAU_SHARE, _MIN_PLATEAU_PX = 0.1, 9
_MIN_PLATEAU_COUNTS = 64
"""Minimum value of a plateau: the shot noise of darker pixels is less than a count, so many are equal."""
_MIN_PLATEAU_RATIO = 3
"""Minimum number of pixels with the largest value, relative to that with the next value below. Of a spot that
is not clipped the latter is the larger number: fewer pixels are the brighter."""

Image = npt.NDArray[np.float32]
"""Counts, irradiance or weights, (rows, columns)."""

Mask = npt.NDArray[np.uint8]
"""0 and 1, (rows, columns)."""


def gaussian_blur(image: Image, sigma_px: float) -> Image:
    """Return the image smoothed by a Gaussian; itself if ``sigma_px`` is 0."""
    if sigma_px <= 0:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), dtype=np.float32)


def clipped_from(bright: PixelArray, full_scale: int) -> float:
    """Return the value from which pixels are clipped, judged by a spot's bright pixels.

    It is ``SATURATED_FROM`` of full scale, or less where many of them share the largest value: a camera that
    delivers fewer bits than its pixels have room for, or that clips below their largest value.
    """
    full, top = SATURATED_FROM * full_scale, int(cv2.minMaxLoc(bright)[1])  # faster than by numpy
    if not _MIN_PLATEAU_COUNTS <= top < full:
        return full
    at_top = np.count_nonzero(bright == top)
    if at_top < max(_MIN_PLATEAU_SHARE * bright.size, _MIN_PLATEAU_PX):
        return full
    next_below = np.count_nonzero(bright == bright[bright < top].max(initial=0))
    return float(top) if at_top >= _MIN_PLATEAU_RATIO * next_below > 0 else full


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of a pixel: ``read_counts`` of the dark camera, shot noise at ``electrons_per_count``."""

    read_counts: float
    electrons_per_count: float


@dataclass(frozen=True, slots=True)
class Centre:
    """Centre of a spot and its sigma by read and shot noise, root mean square of both axes, px."""

    u_px: float
    v_px: float
    sigma_px: float
