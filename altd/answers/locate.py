"""``altd locate``: finds the spot in each of several pictures, one at a time."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from altd.errors import BadInputError
from altd.files.picture import read_picture
from altd.reasons import Reason
from altd.records import Frame, NoSpot, Spot
from altd.tables import SPOT_COLUMNS, TEXT_FORMATS, Row, TextFormat
from altd.vision.frame_analysis import FrameAnalysis, without_hot_pixels
from altd.vision.image import Centre, Image, gaussian_blur
from altd.vision.localise import locate_ellipse, locate_in, second_piece_share, spot_in
from altd.vision.search import Region, robust_sigma
from altd.vision.settings import SpotSettings

UNREADABLE = "unreadable"
_MAX_DIFFERENCE_SIGMAS = 5.0
"""Maximum difference of the localisers; on a clean spot it fits their sigmas (``docs/locate.md``)."""
_MIN_LOBE_LEVEL = 0.6
"""Share of the peak to which the light between two lobes falls; on print it stays above 0.85."""
_MIN_FIELDS_PX, _MIN_FIELDS_SIGMAS = 1.0, 10.0
"""Minimum distance of the spot in even rows from that in odd rows; 0.5 px on print. Each has half of the
light, so their distance has about twice the spot's sigma."""
_MIN_FIELD_SHARE = 0.25
"""Minimum light of the darker field, relative to the other; on print it is above 0.8."""
_MIN_SMALL_SIGMAS, _SMALL_SMOOTHING_PX = 8.0, 1.0
_MAX_SMALL_PX = 1 << 25
"""Maximum size of a picture in which a small spot is looked for: it takes 20 bytes of memory a pixel."""


def answer(images: Iterable[Path], form: TextFormat, report_error: Callable[[str], object]) -> int:
    """Write a row for each picture to standard output; return the exit status, 2 if one could not be read.

    That picture has a row too, so that rows match pictures, and ``report_error`` receives the reason.
    """
    table = TEXT_FORMATS[form](sys.stdout.write, SPOT_COLUMNS)
    status = 0
    for path in images:
        try:
            pixels, bits = read_picture(path)
        except BadInputError as error:
            report_error(str(error))
            table.add({"image": str(path), "reason": UNREADABLE, "detail": error.message})
            status = 2
        else:
            table.add({"image": str(path), **_found(Frame(path.name, 0, 0, pixels, bits))})
    return status


def _found(frame: Frame) -> Row:
    analysis = FrameAnalysis(frame, SpotSettings())
    spot = locate_in(analysis)
    if isinstance(spot, NoSpot):
        small = _too_small(analysis) if spot.reason is Reason.SPOT_MISSING else None
        return {"reason": str((small or spot).reason), "detail": (small or spot).detail}
    second = locate_ellipse(frame)
    row: dict[str, float | str | None] = {
        "u_px": round(spot.u_px, 4),
        "v_px": round(spot.v_px, 4),
        "sigma_px": round(spot.sigma_px, 4),
        "diameter_px": round(spot.diameter_px, 2),
        "peak": round(spot.peak, 1),
        "doubt": doubt(analysis, spot, second),
    }
    if second is not None:
        row |= {
            "ellipse_u_px": round(second.u_px, 4),
            "ellipse_v_px": round(second.v_px, 4),
            "ellipse_sigma_px": round(second.sigma_px, 4),
        }
    return row


def doubt(analysis: FrameAnalysis, spot: Spot, second: Centre | None) -> str | None:
    """Reason to doubt the position of a spot; None if it is one spot and the second localiser agrees."""
    patch = analysis.brightest_patch
    if patch is not None:
        light = np.where(patch.mask > 0, np.maximum(patch.excess, 0), np.float32(0))
        if _fields_apart_px(light) > max(_MIN_FIELDS_PX, _MIN_FIELDS_SIGMAS * spot.sigma_px):
            return "even and odd rows show different pictures: the camera interlaces"
        fine = gaussian_blur(light, analysis.settings.smoothing_px / 2)
        share = second_piece_share(fine > _MIN_LOBE_LEVEL * fine.max())
        if share >= analysis.settings.like_size:
            return f"the spot has two lobes, the second has {share:.0%} of the first one's area"
    if second is None:
        return "the second localiser sees no closed contour"
    apart_px = math.hypot(spot.u_px - second.u_px, spot.v_px - second.v_px)
    allowed_px = _MAX_DIFFERENCE_SIGMAS * math.hypot(spot.sigma_px, second.sigma_px)
    if apart_px <= allowed_px:
        return None
    return f"the two localisers differ by {apart_px:.3f} px, {allowed_px:.3f} px are allowed"


def _fields_apart_px(light: Image) -> float:
    """Return the distance of the light in even rows from that in odd rows; infinite if one is dark."""
    v, u = np.indices(light.shape, np.float32)
    fields = [tuple(float((at * light)[first::2].sum()) for at in (1, u, v)) for first in (0, 1)]
    (even, even_u, even_v), (odd, odd_u, odd_v) = fields
    if min(even, odd) < _MIN_FIELD_SHARE * max(even, odd):
        return math.inf
    return math.hypot(even_u / even - odd_u / odd, even_v / even - odd_v / odd)


def _too_small(analysis: FrameAnalysis) -> NoSpot | None:
    """Return that the one light of a frame is too small; None if there is none, or several.

    The search averages over cells, and its median removes what is smaller than a cell.
    """
    pixels, settings = analysis.frame.pixels, replace(analysis.settings, smoothing_px=_SMALL_SMOOTHING_PX)
    if pixels.size > _MAX_SMALL_PX:
        return None
    excess = without_hot_pixels(pixels) - analysis.found.background.levels((0.0, 0.0), pixels.shape)
    excess = gaussian_blur(excess, settings.smoothing_px)
    _, peak, _, (u, v) = cv2.minMaxLoc(excess)
    lights, _ = cv2.connectedComponents((excess > peak / 2).view(np.uint8))
    if peak < _MIN_SMALL_SIGMAS * robust_sigma(excess) or lights != 2:  # one and the background
        return None
    fine = FrameAnalysis(analysis.frame, settings, analysis.found)
    outcome = spot_in(fine, Region(u, v, u + 1, v + 1, peak, peak))
    return outcome if isinstance(outcome, NoSpot) and outcome.reason is Reason.WRONG_SIZE else None
