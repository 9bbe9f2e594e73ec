"""The lit LEDs of a calibration plate: discs with sub-pixel centres in a picture LEDs on minus LEDs off."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from altd.records import FloatArray
from altd.vision.background import Image, robust_sigma
from altd.vision.localise import shape_of
from altd.vision.patch import Mask, outline_of

_DETECTION_SIGMAS = 6.0
_DETECTION_COUNTS = 2.0
_DETECTION_SHARE = 0.06
_SMALLEST_AREA_PX = 20
_MAX_ASPECT = 2.5
_MIN_FILL = 0.88
_MAX_SOFTNESS, _MUCH_SOFTER = 2.4, 1.5
"""Area above a quarter of the level over area above three quarters: a disc of 3 mm under 30° behind a lens of
3.6 mm has 1.8, a Gaussian glow 2.9. It is one, if it is also so many times softer than most of the lights:
then the LEDs themselves are not as soft."""
_HOT_SHARE = 0.35
_MARGIN_PX = 4
_OUTER, _INNER = 0.25, 0.75
"""The shares of a disc's level between which the softness of its edge is judged."""
_RIM = 0.1, 0.9
"""The shares between which a pixel counts in part. From 0.25 to 0.75 the rim is so narrow that the raster of
the pixels shows (0.008 px instead of 0.004 px without noise)."""
_LEVEL_PERCENTILE = 75.0


@dataclass(frozen=True, slots=True)
class Disc:
    """An evenly bright disc: centre of its area and its area, px; its median brightness, its edge's softness.

    ``cut`` tells that the edge of the picture cuts it, so that its place is not known well.
    ``box`` is the window that it was found in: left, top, right, bottom, the last two past the end.
    """

    u_px: float
    v_px: float
    area_px: float
    level: float
    softness: float
    cut: bool
    box: tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Discs:
    """What was found, and in words what shines but is no LED."""

    found: tuple[Disc, ...]
    rejected: tuple[str, ...]


def find_discs(difference: Image) -> Discs:
    """Discs in the mean picture with the LEDs on minus the one with them off, (h, w) counts.

    What shines alike in both has cancelled. Single pixels, streaks, rings and soft glows, such as
    reflections, are rejected; a reflection as sharp as an LED passes, and must fail to fit the grid.
    """
    calm = cv2.GaussianBlur(cv2.medianBlur(difference, 3), (0, 0), 1.0)
    brightest = float(calm.max())
    level = max(
        _DETECTION_SIGMAS * robust_sigma(calm.astype(np.float32)),
        _DETECTION_COUNTS,
        _DETECTION_SHARE * brightest,
    )
    _, labels, stats, _ = cv2.connectedComponentsWithStats((calm > level).astype(np.uint8), connectivity=8)
    found: list[Disc] = []
    rejected: list[str] = []
    for label, (left, top, width, height, _) in enumerate(np.asarray(stats).tolist()):
        if label == 0:
            continue
        here = slice(top, top + height), slice(left, left + width)
        inside = np.asarray(labels)[here] == label
        half = (calm[here] > 0.5 * float(calm[here][inside].max())) & inside
        parts, part_labels = cv2.connectedComponents(half.astype(np.uint8), connectivity=8)
        for part in range(1, parts):
            mask: Mask = np.equal(part_labels, part).astype(np.uint8)
            disc = _judged(difference, mask, left, top)
            if isinstance(disc, Disc):
                found.append(disc)
            else:
                rejected.append(disc)
    usual = float(np.median([disc.softness for disc in found])) if found else 0.0
    glows = [disc for disc in found if disc.softness > max(_MAX_SOFTNESS, _MUCH_SOFTER * usual)]
    rejected += [f"a light at ({disc.u_px:.0f}, {disc.v_px:.0f}) px has no edge: a glow" for disc in glows]
    return Discs(tuple(disc for disc in found if disc not in glows), tuple(rejected))


def disc_centres_px(difference: Image, discs: tuple[Disc, ...]) -> FloatArray:
    """The discs' centres (n, 2) in another picture of the same scene; NaN for one that is dark there."""
    centres = np.full((len(discs), 2), np.nan)
    for row, disc in enumerate(discs):
        left, top, right, bottom = disc.box
        measured = _centre(difference[top:bottom, left:right], disc.level / 2)
        if measured is not None:
            centres[row] = left + measured[0], top + measured[1]
    return centres


def _judged(difference: Image, mask: Mask, left: int, top: int) -> Disc | str:
    """The disc of a mask at (left, top), or what it is instead."""
    rows, columns = difference.shape
    at_v, at_u = (positions.astype(np.int64) for positions in np.nonzero(mask))
    u, v = left + int(at_u.mean()), top + int(at_v.mean())
    if len(at_u) < _SMALLEST_AREA_PX:
        return f"a light of {len(at_u)} px at ({u}, {v}) px is too small for an LED"
    first_u, last_u, first_v, last_v = (
        left + int(at_u.min()),
        left + int(at_u.max()),
        top + int(at_v.min()),
        top + int(at_v.max()),
    )
    cut = first_u <= 1 or first_v <= 1 or last_u >= columns - 2 or last_v >= rows - 2
    aspect, fill = shape_of(outline_of(mask))
    if not cut and (aspect > _MAX_ASPECT or fill < _MIN_FILL):
        return f"a light at ({u}, {v}) px is no disc: aspect ratio {aspect:.1f}, fill {fill:.2f}"
    margin = _MARGIN_PX + max(last_u - first_u, last_v - first_v) // 3
    box = (
        max(first_u - margin, 0),
        max(first_v - margin, 0),
        min(last_u + 1 + margin, columns),
        min(last_v + 1 + margin, rows),
    )
    window = difference[box[1] : box[3], box[0] : box[2]]
    measured = _centre(window, 0.0)
    if measured is None:
        return f"a light at ({u}, {v}) px has no even inside"
    centre_u, centre_v, area_px, softness = measured
    level = float(np.median(difference[at_v + top, at_u + left]))
    return Disc(box[0] + centre_u, box[1] + centre_v, area_px, level, softness, cut, box)


def _centre(window: Image, least: float) -> tuple[float, float, float, float] | None:
    """Centre of area (u, v) in the window, area px and softness of its edge.

    None without a bright inside, or where nothing is brighter than ``least``.

    The disc's brightness is divided by the plane through its inside, so that neither the fall-off of the
    lens nor an LED brighter on one side moves the centre. Weights rise from 0 at a tenth of that to 1 at
    nine tenths: the inside does not add its noise, and the rim counts by its share of each pixel.
    """
    brightest = float(window.max())
    if brightest <= least:
        return None
    level = float(np.percentile(window[window > 0.5 * brightest], _LEVEL_PERCENTILE))
    calm = np.asarray(cv2.medianBlur(window, 3), dtype=np.float32)
    clean = np.where(np.abs(window - calm) > _HOT_SHARE * level, calm, window)
    _, labels = cv2.connectedComponents((calm > _OUTER * level).astype(np.uint8), connectivity=8)
    labels = np.asarray(labels)
    peak = np.unravel_index(int(cv2.GaussianBlur(calm, (0, 0), 2.0).argmax()), calm.shape)
    if labels[peak] == 0:
        return None
    own = cv2.dilate((labels == labels[peak]).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    core = cv2.erode((own & (clean > 0.5 * level)).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    core &= clean > 0.7 * level
    if np.count_nonzero(core) < 5:
        core = own & (clean > 0.5 * level)
    at_v, at_u = np.nonzero(core)
    design = np.column_stack([np.ones(len(at_u)), at_u, at_v])
    plane, _, rank, _ = np.linalg.lstsq(design, clean[core].astype(np.float64), rcond=None)
    if rank < 3:
        return None
    height, width = window.shape
    even = plane[0] + plane[1] * np.arange(width) + plane[2] * np.arange(height)[:, None]
    share = np.where(own, clean / np.maximum(even, 0.3 * level), 0.0)
    softness = int((share > _OUTER).sum()) / max(int((share > _INNER).sum()), 1)
    if softness > _MAX_SOFTNESS:  # no even inside that a plane could follow
        share = np.where(own, clean / level, 0.0)
    weight = np.clip((share - _RIM[0]) / (_RIM[1] - _RIM[0]), 0.0, 1.0)
    total = float(weight.sum())
    if total <= 0:
        return None
    u = float(weight.sum(axis=0) @ np.arange(width)) / total
    v = float(weight.sum(axis=1) @ np.arange(height)) / total
    return u, v, total, softness
