"""Lit LEDs of a calibration plate: discs with sub-pixel centres in the image LEDs on minus LEDs off."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from altd.records import FloatArray
from altd.vision.frame_analysis import outline_of
from altd.vision.image import Image, Mask
from altd.vision.localise import shape_of
from altd.vision.search import robust_sigma

_DETECTION_SIGMAS = 6.0
_DETECTION_COUNTS = 2.0
_DETECTION_SHARE = 0.06
_MIN_AREA_PX = 20
_MAX_ASPECT = 2.5
_MIN_FILL = 0.88
_MAX_SOFTNESS, _MAX_SOFTNESS_RATIO = 2.4, 1.5
"""Limits of the softness, the area above a quarter of the level over that above three quarters: a disc of 3
mm under 30° behind a lens of 3.6 mm has 1.8, a Gaussian glow 2.9. A glow must also be so many times softer
than the median of the lights: then the LEDs themselves are not as soft."""
_MAX_NEIGHBOUR_DIFFERENCE_SHARE = 0.35
_MARGIN_PX = 4
_OUTER_SHARE, _INNER_SHARE = 0.25, 0.75
"""Shares of a disc's level between which the softness of its edge is measured."""
_RIM_SHARES = 0.1, 0.9
"""Shares between which a pixel counts in part. From 0.25 to 0.75 the rim is so narrow that the raster of the
pixels shows (0.008 px instead of 0.004 px without noise)."""
_LEVEL_PERCENTILE = 75.0


@dataclass(frozen=True, slots=True)
class Disc:
    """Evenly bright disc: centre of its area and its area, px; its median brightness, its edge's softness.

    ``is_cut``: the border of the image cuts it, so that its centre is uncertain. ``box`` is the window that
    it was found in: left, top, right, bottom, the last two exclusive.
    """

    u_px: float
    v_px: float
    area_px: float
    level: float
    softness: float
    is_cut: bool
    box: tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Discs:
    """Discs that were found, and texts on the lights that are no LED."""

    found: tuple[Disc, ...]
    rejected: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _AreaCentre:
    """Centre of a disc's area (u, v) in a window, the area, px, and the softness of the disc's edge."""

    u_px: float
    v_px: float
    area_px: float
    softness: float


def find_discs(difference: Image) -> Discs:
    """Find discs in the mean image with the LEDs on minus the one with them off, (h, w) counts.

    Light that is the same in both has cancelled. Single pixels, streaks, rings and soft glows, such as
    reflections, are rejected; a reflection as sharp as an LED passes, and must fail to match the grid.
    """
    smoothed = cv2.GaussianBlur(cv2.medianBlur(difference, 3), (0, 0), 1.0)
    brightest = float(smoothed.max())
    level = max(
        _DETECTION_SIGMAS * robust_sigma(smoothed.astype(np.float32)),
        _DETECTION_COUNTS,
        _DETECTION_SHARE * brightest,
    )
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        (smoothed > level).astype(np.uint8), connectivity=8
    )
    found: list[Disc] = []
    rejected: list[str] = []
    for label, (left, top, width, height, _) in enumerate(np.asarray(stats).tolist()):
        if label == 0:
            continue
        here = slice(top, top + height), slice(left, left + width)
        inside = np.asarray(labels)[here] == label
        half = (smoothed[here] > 0.5 * float(smoothed[here][inside].max())) & inside
        parts, part_labels = cv2.connectedComponents(half.astype(np.uint8), connectivity=8)
        for part in range(1, parts):
            mask: Mask = np.equal(part_labels, part).astype(np.uint8)
            disc = _classify(difference, mask, left, top)
            if isinstance(disc, Disc):
                found.append(disc)
            else:
                rejected.append(disc)
    median_softness = float(np.median([disc.softness for disc in found])) if found else 0.0
    glows = [
        disc for disc in found if disc.softness > max(_MAX_SOFTNESS, _MAX_SOFTNESS_RATIO * median_softness)
    ]
    rejected += [f"a light at ({disc.u_px:.0f}, {disc.v_px:.0f}) px has no edge: a glow" for disc in glows]
    return Discs(tuple(disc for disc in found if disc not in glows), tuple(rejected))


def disc_centres_px(difference: Image, discs: tuple[Disc, ...]) -> FloatArray:
    """Return the discs' centres (n, 2) in another image of the same scene; NaN for one that is dark there."""
    centres = np.full((len(discs), 2), np.nan)
    for row, disc in enumerate(discs):
        left, top, right, bottom = disc.box
        measured = _area_centre(difference[top:bottom, left:right], disc.level / 2)
        if measured is not None:
            centres[row] = left + measured.u_px, top + measured.v_px
    return centres


def _classify(difference: Image, mask: Mask, left: int, top: int) -> Disc | str:
    """Return the disc of a mask at (left, top), or as text why it is none."""
    rows, columns = difference.shape
    at_v, at_u = (positions.astype(np.int64) for positions in np.nonzero(mask))
    u, v = left + int(at_u.mean()), top + int(at_v.mean())
    if len(at_u) < _MIN_AREA_PX:
        return f"a light of {len(at_u)} px at ({u}, {v}) px is too small for an LED"
    first_u, last_u, first_v, last_v = (
        left + int(at_u.min()),
        left + int(at_u.max()),
        top + int(at_v.min()),
        top + int(at_v.max()),
    )
    is_cut = first_u <= 1 or first_v <= 1 or last_u >= columns - 2 or last_v >= rows - 2
    aspect, fill = shape_of(outline_of(mask))
    if not is_cut and (aspect > _MAX_ASPECT or fill < _MIN_FILL):
        return f"a light at ({u}, {v}) px is not a disc: aspect ratio {aspect:.1f}, fill {fill:.2f}"
    margin = _MARGIN_PX + max(last_u - first_u, last_v - first_v) // 3
    box = (
        max(first_u - margin, 0),
        max(first_v - margin, 0),
        min(last_u + 1 + margin, columns),
        min(last_v + 1 + margin, rows),
    )
    window = difference[box[1] : box[3], box[0] : box[2]]
    measured = _area_centre(window, 0.0)
    if measured is None:
        return f"a light at ({u}, {v}) px has no even inside"
    level = float(np.median(difference[at_v + top, at_u + left]))
    return Disc(
        u_px=box[0] + measured.u_px,
        v_px=box[1] + measured.v_px,
        area_px=measured.area_px,
        level=level,
        softness=measured.softness,
        is_cut=is_cut,
        box=box,
    )


def _area_centre(window: Image, min_counts: float) -> _AreaCentre | None:
    """Return the centre of the disc's area in a window.

    None without a bright inside, or if nothing is brighter than ``min_counts``.

    The disc's brightness is divided by the plane through its inside, so that neither the fall-off of the lens
    nor an LED brighter on one side moves the centre. Weights rise from 0 at a tenth of that to 1 at nine
    tenths: the inside does not add its noise, and the rim counts by its share of each pixel.
    """
    brightest = float(window.max())
    if brightest <= min_counts:
        return None
    level = float(np.percentile(window[window > 0.5 * brightest], _LEVEL_PERCENTILE))
    smoothed = np.asarray(cv2.medianBlur(window, 3), dtype=np.float32)
    mended = np.where(np.abs(window - smoothed) > _MAX_NEIGHBOUR_DIFFERENCE_SHARE * level, smoothed, window)
    _, labels = cv2.connectedComponents((smoothed > _OUTER_SHARE * level).astype(np.uint8), connectivity=8)
    labels = np.asarray(labels)
    peak = np.unravel_index(int(cv2.GaussianBlur(smoothed, (0, 0), 2.0).argmax()), smoothed.shape)
    if labels[peak] == 0:
        return None
    own = cv2.dilate((labels == labels[peak]).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    core = cv2.erode((own & (mended > 0.5 * level)).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    core &= mended > 0.7 * level
    if np.count_nonzero(core) < 5:
        core = own & (mended > 0.5 * level)
    at_v, at_u = np.nonzero(core)
    design = np.column_stack([np.ones(len(at_u)), at_u, at_v])
    plane, _, rank, _ = np.linalg.lstsq(design, mended[core].astype(np.float64), rcond=None)
    if rank < 3:
        return None
    height, width = window.shape
    brightness = plane[0] + plane[1] * np.arange(width) + plane[2] * np.arange(height)[:, None]
    share = np.where(own, mended / np.maximum(brightness, 0.3 * level), 0.0)
    softness = int((share > _OUTER_SHARE).sum()) / max(int((share > _INNER_SHARE).sum()), 1)
    if softness > _MAX_SOFTNESS:  # no even inside that a plane could follow
        share = np.where(own, mended / level, 0.0)
    weight = np.clip((share - _RIM_SHARES[0]) / (_RIM_SHARES[1] - _RIM_SHARES[0]), 0.0, 1.0)
    total = float(weight.sum())
    if total <= 0:
        return None
    u = float(weight.sum(axis=0) @ np.arange(width)) / total
    v = float(weight.sum(axis=1) @ np.arange(height)) / total
    return _AreaCentre(u, v, total, softness)
