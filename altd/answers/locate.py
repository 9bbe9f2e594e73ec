"""``altd locate``: finds the spot in each of several pictures, one at a time."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from altd.errors import BadInputError
from altd.files.picture import read_picture
from altd.records import Frame, Spot
from altd.tables import SPOT_COLUMNS, TEXT_FORMATS, Row, TextFormat
from altd.vision.image import Centre
from altd.vision.localise import locate, locate_ellipse

UNREADABLE = "unreadable"
_MAX_DIFFERENCE_SIGMAS = 5.0
"""Maximum difference of the localisers; on a clean spot it fits their sigmas (``docs/locate.md``)."""


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
    spot = locate(frame)
    if not isinstance(spot, Spot):
        return {"reason": str(spot.reason), "detail": spot.detail}
    second = locate_ellipse(frame)
    row: dict[str, float | str | None] = {
        "u_px": round(spot.u_px, 4),
        "v_px": round(spot.v_px, 4),
        "sigma_px": round(spot.sigma_px, 4),
        "diameter_px": round(spot.diameter_px, 2),
        "peak": round(spot.peak, 1),
        "doubt": doubt(spot, second),
    }
    if second is not None:
        row |= {
            "ellipse_u_px": round(second.u_px, 4),
            "ellipse_v_px": round(second.v_px, 4),
            "ellipse_sigma_px": round(second.sigma_px, 4),
        }
    return row


def doubt(spot: Spot, second: Centre | None) -> str | None:
    """Reason to doubt the position of a spot; None if the second localiser agrees."""
    if second is None:
        return "the second localiser sees no closed contour"
    apart_px = math.hypot(spot.u_px - second.u_px, spot.v_px - second.v_px)
    allowed_px = _MAX_DIFFERENCE_SIGMAS * math.hypot(spot.sigma_px, second.sigma_px)
    if apart_px <= allowed_px:
        return None
    return f"the two localisers differ by {apart_px:.3f} px, {allowed_px:.3f} px are allowed"
