"""Frame LEDs from a pair of frames, lamps on and off; the laser spot may be there in both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np

from altd.reasons import LEDS_LIT, Reason
from altd.records import FloatArray, Frame, NoSpot, PixelArray, Spot
from altd.vision.disc import fit_disc
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.localise import spot_in
from altd.vision.search import Region, Search
from altd.vision.settings import SpotSettings

LED_SETTINGS = SpotSettings(
    method="moment", smoothing_px=1.5, threshold=0.3, power=1.0, min_diameter_px=5.0, max_aspect=2.0
)
"""A flat-headed LED is an evenly bright disc: little smoothing, half-way contour, plain moment."""

_AROUND_PX = 8
_BESIDE_PX = 3
"""An LED need not stand in its reference position to be told from a laser spot."""
_FIRST_RADIUS_PX = 9.0
_UNLIKE = 1.4
"""A disc at the border is an LED when it is no more than this much larger or smaller than the others."""


@dataclass(frozen=True, slots=True)
class Leds:
    """The LEDs that shine, by increasing u, and in words what shines and could not be located."""

    spots: tuple[Spot, ...]
    dropped: tuple[str, ...]


def lit_leds(found: Search, leds_px: FloatArray) -> int:
    """How many of the LEDs at ``leds_px``, (n, 2), shine in one frame, each as a light of its own.

    What floods them all is one light.
    """
    return sum(
        any(
            region.left - _BESIDE_PX <= u_px < region.right + _BESIDE_PX
            and region.top - _BESIDE_PX <= v_px < region.bottom + _BESIDE_PX
            for u_px, v_px in leds_px
        )
        for region in found.regions
    )


def locate_leds(lit: Frame, dark: Frame, settings: SpotSettings = LED_SETTINGS) -> Leds:
    """Positions of the LEDs that shine in ``lit`` and not in ``dark``.

    What shines alike in both frames cancels. An LED at the border of the picture is fitted on what is there.
    """
    difference = replace(lit, pixels=cast("PixelArray", cv2.subtract(lit.pixels, dark.pixels)))
    analysis = FrameAnalysis(difference, settings)
    spots, dropped, at_border = [], [], []
    for region in analysis.found.regions:
        if _reaches_border(region, difference):
            at_border.append(region)
            continue
        spot = spot_in(analysis, region)
        if isinstance(spot, Spot):
            spots.append(spot)
        else:
            dropped.append(_in_words(region, spot))
    radii_px = [spot.diameter_px / 2 for spot in spots]
    for region in at_border:
        spot = _cut(difference, region, float(np.median(radii_px)) if radii_px else None)
        if isinstance(spot, Spot):
            spots.append(spot)
        else:
            dropped.append(_in_words(region, spot))
    return Leds(tuple(sorted(spots, key=lambda spot: spot.u_px)), tuple(dropped))


def _reaches_border(region: Region, frame: Frame) -> bool:
    rows, columns = frame.pixels.shape
    return min(region.left, region.top) <= 0 or region.right >= columns or region.bottom >= rows


def _cut(difference: Frame, region: Region, usual_px: float | None) -> Spot | NoSpot:
    """The LED in a region at the border; ``usual_px`` is the radius of those that are whole."""
    left, top = max(region.left - _AROUND_PX, 0), max(region.top - _AROUND_PX, 0)
    window = difference.pixels[top : region.bottom + _AROUND_PX, left : region.right + _AROUND_PX]
    disc = fit_disc(window.astype(np.float32), usual_px or _FIRST_RADIUS_PX)
    if disc is None:
        return NoSpot(Reason.CUT_BY_EDGE, "too little of it is in the picture")
    if usual_px is not None and not 1 / _UNLIKE < disc.radius_px / usual_px < _UNLIKE:
        return NoSpot(
            Reason.WRONG_SIZE, f"diameter {2 * disc.radius_px:.1f} px, the others have {2 * usual_px:.1f} px"
        )
    return Spot(left + disc.u_px, top + disc.v_px, disc.sigma_px, 2 * disc.radius_px, disc.level)


def _in_words(region: Region, spot: NoSpot) -> str:
    place = f"u {(region.left + region.right) / 2:.0f} v {(region.top + region.bottom) / 2:.0f} px"
    return f"LED at {place}: {spot.reason}" + (f" ({spot.detail})" if spot.detail else "")


def told_from_leds(refused: NoSpot, lit: int, leds: int) -> NoSpot:
    """What was refused, told from the frame LEDs where it is they that shine."""
    if lit < 2 or 2 * lit < leds:
        return refused
    return replace(refused, detail=f"{LEDS_LIT}, {lit} of {leds} shine at their places")
