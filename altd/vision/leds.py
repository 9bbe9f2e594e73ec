"""Frame LEDs from a pair of frames, lamps on and off; the laser spot may be there in both."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import cv2

from altd.records import Frame, PixelArray, Spot
from altd.vision.localise import spot_in
from altd.vision.search import search
from altd.vision.settings import SpotSettings

LED_SETTINGS = SpotSettings(
    method="moment", smoothing_px=1.5, threshold=0.3, power=1.0, min_diameter_px=5.0, max_aspect=2.0
)
"""A flat-headed LED is an evenly bright disc: little smoothing, half-way contour, plain moment."""


def locate_leds(lit: Frame, dark: Frame, settings: SpotSettings = LED_SETTINGS) -> tuple[Spot, ...]:
    """Positions of the LEDs that shine in ``lit`` and not in ``dark``, by increasing u.

    What shines alike in both frames cancels. A lamp that the image edge cuts is left out.
    """
    difference = replace(lit, pixels=cast("PixelArray", cv2.subtract(lit.pixels, dark.pixels)))
    found = search(difference.pixels)
    spots = [spot_in(difference, region, found, settings) for region in found.regions]
    return tuple(sorted((spot for spot in spots if isinstance(spot, Spot)), key=lambda spot: spot.u_px))
