"""Lights that switch with the frame LEDs, and faults of the frames of a check."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np

from altd.measuring.freshness import FreshnessCheck
from altd.records import FloatArray, Frame, PixelArray
from altd.selfcheck.records import LedView
from altd.vision.frame_leds import locate_leds
from altd.vision.search import Region, search

SEARCH_PX = 40.0
"""Radius about its reference in which an LED is searched."""
_CAP_RATIO = 1.5
"""Cap relative to an LED: a foreign light may be far brighter, and the search scales by the brightest."""
_MAX_LIGHTS = 40
_MIN_SIGMA_PX = 1e-3
"""Minimum sigma of a light's position, limited by the raster of its rim."""
_NOISE_RATIO = 4.0
"""Light is above the ninth decile by more than this many times the decile's distance from the median."""


@dataclass(frozen=True, slots=True, eq=False)
class Lights:
    """Lights of one pair, the brightest first.

    Positions (m, 2), their standard deviation per axis (m,), peaks over the background (m,), diameters (m,).
    """

    px: FloatArray
    sigma_px: FloatArray
    peak: FloatArray
    diameter_px: FloatArray


def pairs(view: LedView) -> Iterator[tuple[Frame, Frame]]:
    """Yield each lit frame with the dark one nearest in time that no other has taken; no frame is used twice.

    So the noise of the pairs is independent. Frames beyond that are skipped.
    """
    free = list(view.dark)
    for lit in view.lit:
        if not free:
            return
        nearest = min(range(len(free)), key=lambda index: abs(free[index].t_ns - lit.t_ns))
        yield lit, free.pop(nearest)


def lights_of(lit: Frame, dark: Frame, references_px: FloatArray) -> Lights:
    """Return the lights in ``lit`` that are not in ``dark``, located like the calibration's LEDs (n, 2).

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
        sigma_px=np.array([max(spot.sigma_px, _MIN_SIGMA_PX) for spot in spots]),
        peak=np.array([spot.peak for spot in spots]),
        diameter_px=np.array([spot.diameter_px for spot in spots]),
    )


def _led_level(difference: PixelArray, references_px: FloatArray) -> float:
    """Estimate an LED's brightness, counts: the third brightest of the lights near the references.

    Two foreign lights do not raise it. If there are only two lights, the brightest counts.
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


_EXPOSURE_TOLERANCE = 0.02
_GAIN_TOLERANCE_DB = 0.1
_MIN_BLINK_SHARE = 0.06
"""Minimum change of a light as a share of full scale: a smaller one is dim beside an LED and moves none."""
_NEAR_LED_PX = 20
_SPOT_MARGIN_PX = 16
"""Margin of the spot: the beam vibrates, so a change around the spot is no separate light."""


@dataclass(frozen=True, slots=True)
class FrameFault:
    """Fault of a camera's frames as text; ``spoils``: whether no verdict can be based on them."""

    sentence: str
    spoils: bool


def findings(
    before: Sequence[Frame], lit: Sequence[Frame], after: Sequence[Frame], leds_px: FloatArray
) -> tuple[FrameFault, ...]:
    """Return the faults of one camera's frames, in the order of their exposure.

    ``before`` and ``after`` have the LEDs off, ``lit`` on; ``leds_px`` (n, 2) are their reference positions.
    A light that changes while the LEDs do not is reported; near an LED it makes the check useless.
    """
    frames = (*before, *lit, *after)
    freshness = FreshnessCheck()
    for frame in frames:
        if repeated := freshness.repeated(frame):
            return (FrameFault(f"the camera repeats a picture: {repeated}", spoils=True),)
    if not have_one_exposure(frames):
        return (FrameFault("the exposure was changed during the check", spoils=True),)
    return tuple(
        finding
        for same in ((*before, *after), lit)
        for finding in _blinking(same, (*before, *after), leds_px)
    )


def have_one_exposure(frames: Sequence[Frame]) -> bool:
    """Return whether all frames of one camera were taken with the same exposure time and gain."""
    first = frames[0]
    return all(
        _is_about(frame.exposure_ms, first.exposure_ms, _EXPOSURE_TOLERANCE * (first.exposure_ms or 0.0))
        and _is_about(frame.gain_db, first.gain_db, _GAIN_TOLERANCE_DB)
        for frame in frames
    )


def _is_about(value: float | None, other: float | None, tolerance: float) -> bool:
    return value is other or (value is not None and other is not None and abs(value - other) <= tolerance)


def _blinking(same: Sequence[Frame], dark: Sequence[Frame], leds_px: FloatArray) -> list[FrameFault]:
    """Return the lights that change among frames under the same LEDs, except the spot in all dark frames."""
    pixels = np.stack([frame.pixels for frame in same])
    changes = search(pixels.max(axis=0) - pixels.min(axis=0)).regions
    min_counts = _MIN_BLINK_SHARE * same[0].full_scale
    changes = tuple(change for change in changes if change.peak >= min_counts)
    if not changes:
        return []
    steady = _in_all([search(frame.pixels).regions for frame in dark])
    found = []
    for change in changes:
        if any(_overlap(change, spot, _SPOT_MARGIN_PX) for spot in steady):
            continue
        u_px, v_px = (change.left + change.right) / 2, (change.top + change.bottom) / 2
        is_near = any(math.hypot(u_px - u, v_px - v) <= _NEAR_LED_PX for u, v in leds_px)
        found.append(
            FrameFault(
                f"a light at u {u_px:.0f} v {v_px:.0f} px{', near an LED,' if is_near else ''} appeared or "
                "vanished without the LEDs",
                spoils=is_near,
            )
        )
    return found


def _in_all(regions: Sequence[Sequence[Region]]) -> list[Region]:
    first, *others = regions
    return [each for each in first if all(any(_overlap(each, o, 0) for o in other) for other in others)]


def _overlap(one: Region, other: Region, margin_px: int) -> bool:
    return (
        one.left < other.right + margin_px
        and other.left < one.right + margin_px
        and one.top < other.bottom + margin_px
        and other.top < one.bottom + margin_px
    )
