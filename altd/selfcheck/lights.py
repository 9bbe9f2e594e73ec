"""The lights that switch with the frame LEDs, pair by pair of frames."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np

from altd.records import FloatArray, Frame, PixelArray, Spot
from altd.selfcheck.records import LedView
from altd.vision.frame_leds import locate_leds

SEARCH_PX = 40.0
"""How far from its reference an LED is looked for."""
_CAP_RATIO = 1.5
"""A foreign light may be much brighter than an LED, and the search takes the brightest as its measure."""
_MAX_LIGHTS = 40
_NOISE_RATIO = 4.0
"""Above the ninth decile by so many times its distance from the median there is light, and no noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Lights:
    """The lights of one pair, the brightest first.

    Places (m, 2), their standard deviation an axis (m,), peaks over the background (m,), diameters (m,).
    """

    px: FloatArray
    sigma_px: FloatArray
    peak: FloatArray
    diameter_px: FloatArray


def pairs(view: LedView) -> Iterator[tuple[Frame, Frame]]:
    """Each lit frame with the dark one nearest in time that no other has taken; without overlap of frames.

    So the pairs' noises are independent. Frames beyond that are left out.
    """
    free = list(view.dark)
    for lit in view.lit:
        if not free:
            return
        nearest = min(range(len(free)), key=lambda index: abs(free[index].t_ns - lit.t_ns))
        yield lit, free.pop(nearest)


def lights_of(lit: Frame, dark: Frame, references_px: FloatArray) -> Lights:
    """What shines in ``lit`` and not in ``dark``, located as the calibration's LEDs (n, 2) were.

    Light that is much brighter than an LED is capped, so that it hides none; LEDs are not.
    """
    difference = cast("PixelArray", cv2.subtract(lit.pixels, dark.pixels))
    cap = min(math.ceil(_CAP_RATIO * _led_level(difference, references_px)), lit.full_scale)
    kept = cast("PixelArray", np.minimum(difference, np.asarray(cap, dtype=difference.dtype)))
    nothing = replace(dark, pixels=np.zeros_like(dark.pixels))
    found = locate_leds(replace(lit, pixels=kept), nothing).spots
    spots = sorted(found, key=lambda spot: -spot.peak)[:_MAX_LIGHTS]
    return Lights(
        px=np.array([(spot.u_px, spot.v_px) for spot in spots]).reshape(-1, 2),
        sigma_px=np.array([_sigma_px(spot) for spot in spots]),
        peak=np.array([spot.peak for spot in spots]),
        diameter_px=np.array([spot.diameter_px for spot in spots]),
    )


def _sigma_px(spot: Spot) -> float:
    """The standard deviation of a light's place, an axis: none is known better than its rim's raster."""
    return max(spot.sigma_px, 1e-3)


def _led_level(difference: PixelArray, references_px: FloatArray) -> float:
    """About the brightness of an LED, counts: the third brightest of what shines near the references.

    Two foreign lights do not raise it. Where only two shine at all, the brightest counts.
    """
    rows, columns = difference.shape
    smooth = cv2.blur(difference, (5, 5))
    peaks = []
    for u_px, v_px in references_px.tolist():
        left, right = (int(min(max(u_px + side, 0), columns)) for side in (-SEARCH_PX, SEARCH_PX + 1))
        top, bottom = (int(min(max(v_px + side, 0), rows)) for side in (-SEARCH_PX, SEARCH_PX + 1))
        window = smooth[top:bottom, left:right]
        peaks.append(float(window.max()) if window.size else 0.0)
    middle, high = (float(value) for value in np.percentile(smooth[::4, ::4], (50.0, 90.0)))
    nothing = high + _NOISE_RATIO * (high - middle) + 1.0
    third, brightest = sorted(peaks)[-min(3, len(peaks))], max(peaks)
    return max(third if third > nothing else brightest, 1.0)
