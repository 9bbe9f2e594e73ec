"""Analysis of one frame shared by several steps: noise, bright regions, and the surroundings of each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from altd.reasons import Reason
from altd.records import FaultCause, Frame, NoSpot, PixelArray
from altd.vision.flat import BLOCK_PX
from altd.vision.image import SATURATED_FROM, Image, Mask, Noise, clipped_from, gaussian_blur
from altd.vision.search import Region, Search, pixel_noise, search, search_around
from altd.vision.settings import SpotSettings

_MARGIN_SIGMAS = 3.0
_MIN_HOT_RATIO = 3.0
_MAX_REPAIRED_SINGLY = 5
_RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
"""The eight neighbours of a pixel."""


@dataclass(frozen=True, slots=True)
class Outline:
    """Area, centroid and second moments about it of a mask, px."""

    area: float
    u: float
    v: float
    uu: float
    uv: float
    vv: float


@dataclass(frozen=True, slots=True)
class Patch:
    """Surroundings of a spot: excess over the background, the same smoothed, and the mask of the spot in it.

    ``left`` and ``top`` are multiples of BLOCK_PX, ``pixels`` is the frame's part, ``outline`` the mask's, in
    px of the patch.
    """

    left: int
    top: int
    pixels: PixelArray
    excess: Image
    smooth: Image
    background_counts: float
    """Background in the middle."""
    uneven_counts: float
    """``Background.uneven_counts``."""
    peak: float
    """Peak of the smoothed excess."""
    mask: Mask
    core: npt.NDArray[np.bool_]
    """Pixels of the spot above half the smoothed peak."""
    clipped_from: float
    """Value from which its pixels are clipped."""
    outline: Outline
    is_cut: bool
    """Whether the spot reaches the edge of the image."""


def patch_around(frame: Frame, region: Region, found: Search, settings: SpotSettings) -> Patch | NoSpot:
    """Cut out and smooth the region, with a margin that holds the spot's contour or ends with the image."""
    rows, columns = frame.pixels.shape
    margin = max(8, BLOCK_PX * math.ceil(_MARGIN_SIGMAS * settings.smoothing_px / BLOCK_PX))
    while True:
        left, top = max(region.left - margin, 0), max(region.top - margin, 0)
        right, bottom = min(region.right + margin, columns), min(region.bottom + margin, rows)
        pixels = frame.pixels[top:bottom, left:right]
        excess = without_hot_pixels(pixels)
        background = found.background.levels((left, top), excess.shape)
        excess -= background
        smooth = gaussian_blur(excess, settings.smoothing_px)
        _, peak, _, (peak_u, peak_v) = cv2.minMaxLoc(smooth)
        if peak <= 0:
            return NoSpot(Reason.SPOT_MISSING, "only single pixels shine")
        mask = _connected_component(smooth > settings.threshold * peak, peak_u, peak_v)
        image_borders = left == 0, top == 0, right == columns, bottom == rows
        at_image_edge, at_patch_edge = _touches(mask, image_borders)
        if not at_patch_edge:
            middle = float(background[len(background) // 2, background.shape[1] // 2])
            outline = outline_of(mask)
            core = (smooth > 0.5 * peak) & (mask > 0)
            clipped = clipped_from(pixels[core], frame.full_scale)
            uneven = found.background.uneven_counts
            surroundings = left, top, pixels, excess, smooth, middle, uneven
            return Patch(*surroundings, peak, mask, core, clipped, outline, at_image_edge)
        margin *= 2


def without_hot_pixels(window: PixelArray) -> Image:
    """Return a window of the frame as float; neighbours' medians replace single bright pixels.

    A pixel is hot if it exceeds the window's floor three times as far as the brightest of its eight
    neighbours does: the smallest printed dot spreads over more than one pixel, a hot pixel does not.
    """
    image: Image = window.astype(np.float32)
    floor = float(np.partition(window.ravel(), image.size // 4)[image.size // 4])
    limit = cv2.dilate(window, _RING).astype(np.float32)
    np.maximum(limit, floor + 3, out=limit)
    limit *= _MIN_HOT_RATIO
    limit -= (_MIN_HOT_RATIO - 1) * floor  # all are whole numbers, so nothing is rounded
    hot = np.flatnonzero(image > limit).tolist()
    if len(hot) > _MAX_REPAIRED_SINGLY:
        image.ravel()[hot] = cv2.medianBlur(window, 5).ravel()[hot]
        return image
    for place in hot:  # a few µs each, against 20 µs for the whole window
        v, u = divmod(place, window.shape[1])
        top, left = max(v - 2, 0), max(u - 2, 0)
        image[v, u] = cv2.medianBlur(window[top : v + 3, left : u + 3], 5)[v - top, u - left]
    return image


def _connected_component(mask: npt.NDArray[np.bool_], u: int, v: int) -> Mask:
    """Return the part of a mask that is connected with pixel (u, v)."""
    _, labels = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)
    mask_of_spot: Mask = np.equal(labels, labels[v, u]).view(np.uint8)
    return mask_of_spot


def _touches(mask: Mask, image_borders: tuple[bool, bool, bool, bool]) -> tuple[bool, bool]:
    """Return whether the mask reaches a border of the image, and whether another border of the patch.

    ``image_borders``: which borders of the patch are the image's, left, top, right, bottom.
    """
    left, top, width, height = cv2.boundingRect(mask)
    rows, columns = mask.shape
    reached = left == 0, top == 0, left + width == columns, top + height == rows
    return (
        any(r and o for r, o in zip(reached, image_borders, strict=True)),
        any(r and not o for r, o in zip(reached, image_borders, strict=True)),
    )


def outline_of(mask: Mask) -> Outline:
    """Return the outline of a non-empty mask of 0 and 1."""
    m = cv2.moments(mask)
    area = m["m00"]
    return Outline(
        area, m["m10"] / area, m["m01"] / area, m["mu20"] / area, m["mu11"] / area, m["mu02"] / area
    )


class FrameAnalysis:
    """A frame, the coarse search over it, the noise of its pixels and the surroundings of its regions.

    Localiser, frame LEDs and fingerprint share one analysis, so that the search runs once. ``found`` is the
    search if it has already been made.
    """

    def __init__(self, frame: Frame, settings: SpotSettings, found: Search | None = None) -> None:
        self.frame = frame
        self.settings = settings
        self._found = found
        self._patches: dict[Region, Patch | NoSpot] = {}

    @property
    def found(self) -> Search:
        """Background and bright regions."""
        if self._found is None:
            self._found = search(self.frame.pixels)
        return self._found

    @cached_property
    def noise(self) -> Noise:
        """Noise of the frame's pixels."""
        read_counts = pixel_noise(self.frame.pixels, self.found.background)
        return Noise(read_counts, self.settings.full_well_electrons / self.frame.full_scale)

    def patch(self, region: Region) -> Patch | NoSpot:
        """Return the surroundings of a bright region of this frame, or why there is no spot in it."""
        patch = self._patches.get(region)
        if patch is None:
            patch = self._patches[region] = patch_around(self.frame, region, self.found, self.settings)
        return patch

    def around_spot(self) -> FrameAnalysis | None:
        """Return the analysis over the background around the brightest spot.

        None if that is no other one, or if the edge of the image cuts the spot.
        """
        found = search_around(self.frame.pixels, self.found)
        other = FrameAnalysis(self.frame, self.settings, found)
        if found is None or (patch := other.brightest_patch) is None or patch.is_cut:
            return None
        other.noise = self.noise
        return other

    def become(self, other: FrameAnalysis) -> None:
        """Take over the search of another analysis of the same frame."""
        self._found, self._patches = other.found, other._patches

    @property
    def brightest_patch(self) -> Patch | None:
        """Surroundings of the brightest region; None if there is none, or only single pixels shine."""
        patch = self.patch(self.found.regions[0]) if self.found.regions else None
        return patch if isinstance(patch, Patch) else None


def brightest_region(analysis: FrameAnalysis) -> Region | NoSpot:
    """Return the region of most light, or why none is the one spot of the frame."""
    frame, found = analysis.frame, analysis.found
    if found.background.level >= SATURATED_FROM * frame.full_scale:
        return NoSpot(Reason.SATURATED, "the whole frame is saturated", FaultCause.FLOODED)
    if not found.regions:
        return NoSpot(Reason.SPOT_MISSING, "nothing is brighter than the background")
    first, *others = found.regions
    second = max((other.light for other in others), default=0.0)
    if second >= analysis.settings.like_size * first.light:
        return NoSpot(
            Reason.AMBIGUOUS, f"a second spot has {second / first.light:.0%} of the first one's light"
        )
    return first
