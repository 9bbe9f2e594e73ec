"""Coarse search: the bright regions of the whole frame, the best one first."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import PixelArray
from altd.vision.background import (
    CELL_PX,
    Background,
    coarse_image,
    excess_over,
    fit_background,
    robust_sigma,
)
from altd.vision.image import Image

_DETECTION_SIGMAS = 8.0
_DETECTION_COUNTS = 1.5
_REGION_PEAK_SHARE = 0.1
_MIN_PEAK_SHARE = 0.4


@dataclass(frozen=True, slots=True)
class Region:
    """A bright region: window in px (right and bottom are past the end), light and peak over background.

    ``light`` is the sum over coarse cells, ``peak`` the brightest cell, both in counts.
    """

    left: int
    top: int
    right: int
    bottom: int
    light: float
    peak: float


@dataclass(frozen=True, slots=True)
class Search:
    """Result of the coarse search: the background and the bright regions, most light first."""

    background: Background
    regions: tuple[Region, ...]


def search(pixels: PixelArray) -> Search:
    """Bright regions of a frame that noise does not explain.

    A region must exceed the coarse image's own noise by eight sigma (among 5 640 cells, four are
    usual) and be no dimmer than a tenth of the brightest.
    """
    coarse = coarse_image(pixels)
    background = fit_background(coarse)
    excess = excess_over(coarse, background)
    detection = max(_DETECTION_SIGMAS * robust_sigma(excess), _DETECTION_COUNTS)
    brightest = float(excess.max())
    if brightest < detection:
        return Search(background, ())
    regions = _regions(excess, max(detection / 2, _REGION_PEAK_SHARE * brightest))
    distinct = [region for region in regions if region.peak >= max(detection, _MIN_PEAK_SHARE * brightest)]
    return Search(background, tuple(sorted(distinct, key=lambda region: -region.light)))


def _regions(excess: Image, level: float) -> list[Region]:
    # Grana's algorithm: on images so small three times as fast as OpenCV's choice. Its statistics would
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
