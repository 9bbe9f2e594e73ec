"""Whether the frames of a check show what they should: new pictures, one exposure, no light that blinks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.measuring.freshness import FreshnessCheck
from altd.records import FloatArray, Frame
from altd.vision.search import Region, search

_EXPOSURE_TOLERANCE = 0.02
_GAIN_TOLERANCE_DB = 0.1
_MIN_BLINK_SHARE = 0.06
"""Of full scale: a light that changes by less is dim beside an LED and moves none."""
_NEAR_LED_PX = 20
_SPOT_MARGIN_PX = 16
"""The beam trembles; what changes about its spot is no light of its own."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What was seen in a camera's frames, in words; ``spoils``: no verdict can rest on them."""

    sentence: str
    spoils: bool


def findings(
    before: Sequence[Frame], lit: Sequence[Frame], after: Sequence[Frame], leds_px: FloatArray
) -> tuple[Finding, ...]:
    """What speaks against the frames of one camera, in the order of their exposure.

    ``before`` and ``after`` have the LEDs off, ``lit`` on; ``leds_px`` (n, 2) are their reference positions.
    A light that comes or goes while the LEDs are left alone is told; near an LED it spoils the check.
    """
    frames = (*before, *lit, *after)
    freshness = FreshnessCheck()
    for frame in frames:
        if repeated := freshness.repeated(frame):
            return (Finding(f"the camera stands still: {repeated}", spoils=True),)
    if not have_one_exposure(frames):
        return (Finding("the exposure was changed during the check", spoils=True),)
    return tuple(
        finding
        for same in ((*before, *after), lit)
        for finding in _blinking(same, (*before, *after), leds_px)
    )


def have_one_exposure(frames: Sequence[Frame]) -> bool:
    """Whether all frames of one camera were taken with the same exposure time and gain."""
    first = frames[0]
    return all(
        _is_about(frame.exposure_ms, first.exposure_ms, _EXPOSURE_TOLERANCE * (first.exposure_ms or 0.0))
        and _is_about(frame.gain_db, first.gain_db, _GAIN_TOLERANCE_DB)
        for frame in frames
    )


def _is_about(value: float | None, other: float | None, tolerance: float) -> bool:
    return value is other or (value is not None and other is not None and abs(value - other) <= tolerance)


def _blinking(same: Sequence[Frame], dark: Sequence[Frame], leds_px: FloatArray) -> list[Finding]:
    """The lights that change among frames under the same LEDs, but for the spot that all dark frames show."""
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
            Finding(
                f"a light at u {u_px:.0f} v {v_px:.0f} px{', near an LED,' if is_near else ''} came or went "
                "by itself",
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
