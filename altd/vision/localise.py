"""Fine localisation: the first-order moment of (I − T)₊ in the region of interest (thesis 2.1.1, 2.1.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import Frame, NoSpot, PixelArray, Reason, Spot
from altd.vision.background import Image, pixel_noise
from altd.vision.search import Region, Search, search
from altd.vision.settings import SpotSettings

Mask = npt.NDArray[np.uint8]

_MARGIN_SIGMAS = 3.0
_HOT_RATIO = 3.0
_SATURATED_FROM = 0.995
_NOISE_BLOCK_PX = 4
_E2 = math.exp(-2.0)
_RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
"""The eight neighbours of a pixel."""


def locate(frame: Frame, settings: SpotSettings | None = None) -> Spot | NoSpot:
    """Find the one laser spot of a frame, or say why there is none.

    The centroid is in px, (0, 0) the middle of the top-left pixel. ``sigma_px`` is what read and shot noise
    do to it; it does not hold the fixed pattern of print and speckle, which the calibration knows.
    """
    settings = settings or SpotSettings()
    found = search(frame.pixels)
    saturated_from = _SATURATED_FROM * frame.full_scale
    if found.background.level >= saturated_from:
        return NoSpot(Reason.SATURATED, "the whole frame is saturated")
    if not found.regions:
        return NoSpot(Reason.SPOT_MISSING, "nothing stands out of the background")
    first, *others = found.regions
    rival = max((other.light for other in others), default=0.0)
    if rival >= settings.like_size * first.light:
        return NoSpot(
            Reason.AMBIGUOUS, f"a second spot has {rival / first.light:.0%} of the first one's light"
        )
    return spot_in(frame, first, found, settings)


def spot_in(frame: Frame, region: Region, found: Search, settings: SpotSettings) -> Spot | NoSpot:
    """The spot in one bright region of a frame, whatever else shines, or why it is none."""
    patch = _patch_around(frame, region, found, settings)
    return patch if isinstance(patch, NoSpot) else _judge(frame, patch, found, settings)


@dataclass(frozen=True, slots=True)
class _Patch:
    """The region of interest: excess over the background, smoothed, and the mask of the spot in it."""

    left: int
    top: int
    excess: Image
    smooth: Image
    peak: float
    """Of the smoothed excess."""
    mask: Mask


def _patch_around(frame: Frame, region: Region, found: Search, settings: SpotSettings) -> _Patch | NoSpot:
    """Cut out and smooth the region, growing it until the spot's contour lies inside."""
    rows, columns = frame.pixels.shape
    margin = max(8, math.ceil(_MARGIN_SIGMAS * settings.smoothing_px))
    while True:
        left, top = max(region.left - margin, 0), max(region.top - margin, 0)
        right, bottom = min(region.right + margin, columns), min(region.bottom + margin, rows)
        excess = without_hot_pixels(frame.pixels[top:bottom, left:right])
        excess -= found.background.at(
            np.arange(left, right, dtype=np.float64), np.arange(top, bottom, dtype=np.float64)
        )
        smooth = _smoothed(excess, settings.smoothing_px)
        _, peak, _, (peak_u, peak_v) = cv2.minMaxLoc(smooth)
        if peak <= 0:
            return NoSpot(Reason.SPOT_MISSING, "only single pixels shine")
        mask = _connected(smooth > settings.threshold * peak, peak_u, peak_v)
        at_image_edge, at_patch_edge = _touches(mask, left == 0, top == 0, right == columns, bottom == rows)
        if at_image_edge:
            return NoSpot(Reason.CUT_BY_EDGE, "the spot reaches the edge of the image")
        if not at_patch_edge:
            return _Patch(left, top, excess, smooth, peak, mask)
        margin *= 2


def _smoothed(image: Image, sigma_px: float) -> Image:
    if sigma_px <= 0:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), dtype=np.float32)


def without_hot_pixels(window: PixelArray) -> Image:
    """A window of the frame as float, with single bright pixels replaced by their neighbours' median.

    A pixel is hot when it stands out of the window's floor three times as far as the brightest of its eight
    neighbours: the smallest printed dot spreads over more than one pixel, a hot pixel does not.
    """
    image: Image = window.astype(np.float32)
    floor = float(np.partition(image.ravel(), image.size // 4)[image.size // 4])
    limit = cv2.dilate(window, _RING).astype(np.float32)
    np.maximum(limit, floor + 3, out=limit)
    limit *= _HOT_RATIO
    limit -= (_HOT_RATIO - 1) * floor  # all of it whole numbers, so nothing is rounded
    hot = image > limit
    if hot.any():
        image[hot] = cv2.medianBlur(window, 5)[hot]
    return image


def _connected(mask: npt.NDArray[np.bool_], u: int, v: int) -> Mask:
    """The part of a mask that hangs together with pixel (u, v)."""
    _, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    mask_of_spot: Mask = np.equal(labels, labels[v, u]).astype(np.uint8)
    return mask_of_spot


def _touches(mask: Mask, left: bool, top: bool, right: bool, bottom: bool) -> tuple[bool, bool]:
    """Whether the mask reaches a border that is the image's own, and whether it reaches another one."""
    reached = (mask[:, 0].any(), mask[0].any(), mask[:, -1].any(), mask[-1].any())
    own = (left, top, right, bottom)
    return (
        any(r and o for r, o in zip(reached, own, strict=True)),
        any(r and not o for r, o in zip(reached, own, strict=True)),
    )


def _judge(frame: Frame, patch: _Patch, found: Search, settings: SpotSettings) -> Spot | NoSpot:
    """Classify the contour by size and shape (2.1.1); take the moment of what passes."""
    peak, clipped = _brightness(frame, patch)
    if clipped > settings.max_saturated:
        return NoSpot(Reason.SATURATED, f"{clipped:.0%} of the spot's bright pixels are saturated")
    rival = _second_half_peak(patch)
    if rival >= settings.like_size:
        return NoSpot(
            Reason.AMBIGUOUS, f"two spots touch, the second has {rival:.0%} of the first one's area"
        )
    diameter_px = _diameter_px(patch, settings)
    largest = settings.max_diameter_px or 0.6 * min(frame.pixels.shape)
    if not settings.min_diameter_px <= diameter_px <= largest:
        limits = f"{settings.min_diameter_px:.0f} to {largest:.0f} px"
        return NoSpot(Reason.WRONG_SIZE, f"diameter {diameter_px:.1f} px, expected {limits}")
    aspect, fill = shape_of(patch.mask)
    if aspect > settings.max_aspect or fill < settings.min_fill:
        return NoSpot(Reason.WRONG_SHAPE, f"aspect ratio {aspect:.1f}, fill {fill:.2f}")
    return _moment(frame, patch, found, settings, diameter_px, peak)


def _brightness(frame: Frame, patch: _Patch) -> tuple[float, float]:
    """Peak of the spot over the background, and the saturated fraction of its bright pixels.

    The peak is where the brightest hundredth of the core begins, so that a hot pixel among the dots makes
    none. Bright is what reaches half of it: on the printed window the dots, not the glass between them.
    """
    core = (patch.smooth > 0.5 * patch.peak) & (patch.mask > 0)
    height, width = core.shape
    raw = frame.pixels[patch.top : patch.top + height, patch.left : patch.left + width][core]
    excess = patch.excess[core]
    brightest = len(excess) - 1 - len(excess) // 100
    peak = float(np.partition(excess, brightest)[brightest])
    bright = excess >= 0.5 * peak
    return peak, float(np.mean(raw[bright] >= _SATURATED_FROM * frame.full_scale))


def _second_half_peak(patch: _Patch) -> float:
    """Area of the second largest piece above half the peak, relative to the largest."""
    core = (patch.smooth > 0.5 * patch.peak) & (patch.mask > 0)
    count, labels = cv2.connectedComponents(core.astype(np.uint8))
    if count <= 2:
        return 0.0
    areas = np.sort(np.bincount(np.asarray(labels).ravel())[1:])[::-1]
    return float(areas[1] / areas[0])


def _diameter_px(patch: _Patch, settings: SpotSettings) -> float:
    """1/e² diameter of the circle of equal area, without what the smoothing added (a Gaussian's 4 sigma)."""
    area = np.count_nonzero((patch.smooth > _E2 * patch.peak) & (patch.mask > 0))
    return math.sqrt(max(4 * area / math.pi - 16 * settings.smoothing_px**2, 0.0))


def shape_of(mask: Mask) -> tuple[float, float]:
    """Aspect ratio of the ellipse with the mask's second moments, and the mask's area over that ellipse's."""
    m = cv2.moments(mask, binaryImage=True)
    area = m["m00"]
    # 1/12: the second moment of a pixel, so that a thin line has a width
    uu, vv, uv = m["mu20"] / area + 1 / 12, m["mu02"] / area + 1 / 12, m["mu11"] / area
    mean, spread = (uu + vv) / 2, math.hypot((uu - vv) / 2, uv)
    major, minor = mean + spread, max(mean - spread, 1e-9)
    return math.sqrt(major / minor), area / (4 * math.pi * math.sqrt(major * minor))


def _moment(
    frame: Frame, patch: _Patch, found: Search, settings: SpotSettings, diameter_px: float, peak: float
) -> Spot | NoSpot:
    """Eq. 2.7 with I replaced by (I − T)₊, and the noise of the result."""
    over = np.maximum(patch.smooth - np.float32(settings.threshold * patch.peak), np.float32(0))
    over[patch.mask == 0] = 0
    weight = np.zeros_like(over)
    inside = over > 0  # the power of zero is what takes cv2.pow longest
    weight[inside] = np.asarray(cv2.pow(over[inside], settings.power)).ravel()
    columns = cv2.reduce(weight, 0, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
    rows = cv2.reduce(weight, 1, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
    total = float(columns.sum())
    u = float(columns @ np.arange(len(columns))) / total
    v = float(rows @ np.arange(len(rows))) / total
    noise = pixel_noise(frame.pixels, found.background)
    sigma_px = _moment_sigma_px(patch, over, weight, total, (u, v), noise, frame.full_scale, settings)
    if sigma_px > settings.max_sigma_px:
        return NoSpot(Reason.SPOT_MISSING, f"too dim: its place is uncertain by {sigma_px:.1f} px")
    return Spot(patch.left + u, patch.top + v, sigma_px, diameter_px, peak)


def _moment_sigma_px(
    patch: _Patch,
    over: Image,
    weight: Image,
    total: float,
    centre: tuple[float, float],
    noise: float,
    full_scale: int,
    settings: SpotSettings,
) -> float:
    """Propagate read noise r and shot noise I/K through smoothing, threshold and moment.

    du = Σ h dI with h = Gauss ⊛ [(u − ū) p (S − T)₊^(p−1) / Σ w]; var u = Σ h² (r² + I/K). It is summed on
    blocks of 4 px, on which h and I hardly change. Returns the root mean square of both axes.
    """
    # At the contour the root's derivative diverges: nearer to it than the smoothed noise it means nothing.
    floor = noise / max(1.0, 2 * math.sqrt(math.pi) * settings.smoothing_px)
    slope = np.where(over > floor, weight, np.float32(floor**settings.power))  # over^p
    slope *= settings.power / total
    slope /= np.maximum(over, np.float32(floor))
    slope[over == 0] = 0
    height, width = slope.shape
    lever_u = slope * (np.arange(width, dtype=np.float32) - np.float32(centre[0]))
    lever_v = slope * (np.arange(height, dtype=np.float32) - np.float32(centre[1]))[:, None]
    size = max(width // _NOISE_BLOCK_PX, 1), max(height // _NOISE_BLOCK_PX, 1)
    stacked = cv2.merge([lever_u, lever_v, np.maximum(patch.smooth, 0)])
    blocks = cv2.resize(stacked, size, interpolation=cv2.INTER_AREA)
    levers = blocks[:, :, :2]
    if settings.smoothing_px > 0:
        levers = cv2.GaussianBlur(levers, (0, 0), settings.smoothing_px / _NOISE_BLOCK_PX)
    variance = noise**2 + blocks[:, :, 2] * (full_scale / settings.full_well_electrons)
    pixels_per_block = width * height / (size[0] * size[1])
    per_axis = (np.square(levers) * variance[:, :, None]).sum(axis=(0, 1)) * pixels_per_block
    return math.sqrt(float(per_axis.mean()))
