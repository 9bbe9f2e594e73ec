"""The frame LEDs in a pair of frames, LEDs on and off; the laser spot may be there in both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np

from altd.reasons import LEDS_LIT, Reason
from altd.records import FloatArray, Frame, NoSpot, PixelArray, Spot
from altd.vision.disc_fit import fit_disc
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.localise import spot_in
from altd.vision.search import Region, Search
from altd.vision.settings import SpotSettings

LED_SETTINGS = SpotSettings(
    method="moment", smoothing_px=1.5, threshold=0.3, power=1.0, min_diameter_px=5.0, max_aspect=2.0
)
"""A flat-headed LED is an evenly bright disc: little smoothing, half-way contour, plain moment."""

_MARGIN_PX = 8
_PLACE_TOLERANCE_PX = 3
"""An LED need not stand in its reference position to be told from a laser spot."""
_INITIAL_RADIUS_PX = 9.0
_MAX_SIZE_RATIO = 1.4
"""A disc at the border is an LED when it is at most this much larger or smaller than the others."""


@dataclass(frozen=True, slots=True)
class Leds:
    """The located LEDs by increasing u, and in words the lights that could not be located."""

    spots: tuple[Spot, ...]
    rejected: tuple[str, ...]


def count_lit_leds(found: Search, leds_px: FloatArray) -> int:
    """How many of the LEDs at ``leds_px``, (n, 2), are lit in one frame, each as a bright region of its own.

    Light that floods them all is one region.
    """
    return sum(
        any(
            region.left - _PLACE_TOLERANCE_PX <= u_px < region.right + _PLACE_TOLERANCE_PX
            and region.top - _PLACE_TOLERANCE_PX <= v_px < region.bottom + _PLACE_TOLERANCE_PX
            for u_px, v_px in leds_px
        )
        for region in found.regions
    )


def locate_leds(lit: Frame, dark: Frame, settings: SpotSettings = LED_SETTINGS) -> Leds:
    """Positions of the LEDs that are lit in ``lit`` and not in ``dark``.

    Light that is the same in both frames cancels. An LED at the border of the picture is fitted on what is
    there.
    """
    difference = replace(lit, pixels=cast("PixelArray", cv2.subtract(lit.pixels, dark.pixels)))
    analysis = FrameAnalysis(difference, settings)
    spots, rejected, at_border = [], [], []
    for region in analysis.found.regions:
        if _reaches_border(region, difference):
            at_border.append(region)
            continue
        spot = spot_in(analysis, region)
        if isinstance(spot, Spot):
            spots.append(spot)
        else:
            rejected.append(_rejection_text(region, spot))
    radii_px = [spot.diameter_px / 2 for spot in spots]
    for region in at_border:
        spot = _fit_at_border(difference, region, float(np.median(radii_px)) if radii_px else None)
        if isinstance(spot, Spot):
            spots.append(spot)
        else:
            rejected.append(_rejection_text(region, spot))
    return Leds(tuple(sorted(spots, key=lambda spot: spot.u_px)), tuple(rejected))


def _reaches_border(region: Region, frame: Frame) -> bool:
    rows, columns = frame.pixels.shape
    return min(region.left, region.top) <= 0 or region.right >= columns or region.bottom >= rows


def _fit_at_border(difference: Frame, region: Region, usual_radius_px: float | None) -> Spot | NoSpot:
    """The LED in a region at the border; ``usual_radius_px`` is the radius of those that are whole."""
    left, top = max(region.left - _MARGIN_PX, 0), max(region.top - _MARGIN_PX, 0)
    window = difference.pixels[top : region.bottom + _MARGIN_PX, left : region.right + _MARGIN_PX]
    disc = fit_disc(window.astype(np.float32), usual_radius_px or _INITIAL_RADIUS_PX)
    if disc is None:
        return NoSpot(Reason.CUT_BY_EDGE, "too little of it is in the picture")
    if (
        usual_radius_px is not None
        and not 1 / _MAX_SIZE_RATIO < disc.radius_px / usual_radius_px < _MAX_SIZE_RATIO
    ):
        return NoSpot(
            Reason.WRONG_SIZE,
            f"diameter {2 * disc.radius_px:.1f} px, the others have {2 * usual_radius_px:.1f} px",
        )
    return Spot(left + disc.u_px, top + disc.v_px, disc.sigma_px, 2 * disc.radius_px, disc.level)


def _rejection_text(region: Region, spot: NoSpot) -> str:
    place = f"u {(region.left + region.right) / 2:.0f} v {(region.top + region.bottom) / 2:.0f} px"
    return f"LED at {place}: {spot.reason}" + (f" ({spot.detail})" if spot.detail else "")


def with_leds_as_cause(refused: NoSpot, lit: int, leds: int) -> NoSpot:
    """What was refused, with the lit frame LEDs as the cause where it is they that are seen."""
    if lit < 2 or 2 * lit < leds:
        return refused
    return replace(refused, detail=f"{LEDS_LIT}, {lit} of {leds} shine at their places")
