"""The state of each LED: used, or why not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import FloatArray, Frame, PixelArray
from altd.selfcheck.records import LedState

_DIM_SHARE = 0.4
_DARK_SHARE = 0.05
_MIN_SEEN_SHARE = 0.8
_MARGIN_PX = 3.0
_BRIGHT_SHARE = 0.04
"""Of full scale, over twice the frame's median: light with the LEDs off that is no ambient light."""
_LIT_PERCENTILE = 97.0
"""Hot pixels aside: the rim of a spot over an LED moves its place where both together reach full scale."""


_UNEVEN_SHARE = 0.012
"""Of full scale, by which the darkness under one LED is more uneven than twice that of most."""
_CLIPPED_SHARE = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A target's LEDs, as the pairs show them.

    ``places_px`` (n, 2) are where they are, or where they should be; ``peaks`` (n,) their brightness, NaN
    where not seen; ``share`` (n,) in how many of the pairs they are seen, 0 to 1.
    """

    pairs: Sequence[tuple[Frame, Frame]]
    places_px: FloatArray
    peaks: FloatArray
    share: FloatArray
    diameter_px: float


def states_of(seen: Seen) -> tuple[LedState, ...]:
    """The state of each LED, in their order."""
    usual = float(np.nanmedian(seen.peaks)) if np.isfinite(seen.peaks).any() else 0.0
    touched = _touched(seen)
    return tuple(
        LedState.HIDDEN if touched[index] and state is LedState.USED else state
        for index, state in enumerate(_state(seen, index, usual) for index in range(len(seen.places_px)))
    )


def _touched(seen: Seen) -> npt.NDArray[np.bool_]:
    """Over which LEDs, (n,), faint light that the others do not have brings some pixels to full scale.

    What is cut off there on one side moves the place of an LED: the rim of a spot by 0.1 px.
    """
    if not seen.pairs:
        return np.zeros(len(seen.places_px), dtype=np.bool_)
    reach = seen.diameter_px / 2 + _MARGIN_PX
    uneven, clipped = np.zeros(len(seen.places_px)), np.zeros(len(seen.places_px))
    for lit, dark in seen.pairs:
        smooth = replace(dark, pixels=cast("PixelArray", cv2.blur(dark.pixels, (5, 5))))
        for index, (u, v) in enumerate(seen.places_px.tolist()):
            window = _window(smooth, u, v, reach)
            if window.size:
                low, high = np.percentile(window, (100 - _LIT_PERCENTILE, _LIT_PERCENTILE))
                uneven[index] += float(high - low) / dark.full_scale / len(seen.pairs)
                full = _window(lit, u, v, reach) >= lit.full_scale
                clipped[index] = max(clipped[index], float(full.mean()))
    limit = 2 * float(np.median(uneven)) + _UNEVEN_SHARE
    touched: npt.NDArray[np.bool_] = (uneven > limit) & (clipped > _CLIPPED_SHARE)
    return touched


def _state(seen: Seen, index: int, usual: float) -> LedState:
    u, v = seen.places_px[index].tolist()
    reach = seen.diameter_px / 2 + _MARGIN_PX
    if not seen.pairs:
        return LedState.DARK
    rows, columns = seen.pairs[0][0].pixels.shape
    if min(u, v) < reach or u > columns - 1 - reach or v > rows - 1 - reach:
        return LedState.CUT
    if (light := _foreign_light(seen, u, v, reach)) is not None:
        return light
    peak = float(seen.peaks[index])
    if seen.share[index] >= _MIN_SEEN_SHARE:
        return LedState.DIM if peak < _DIM_SHARE * usual else LedState.USED
    if seen.share[index] > 0:
        return LedState.UNSTEADY
    brightness = np.mean([_brightness(lit, u, v) - _brightness(dark, u, v) for lit, dark in seen.pairs])
    if not usual or brightness < _DARK_SHARE * usual:
        return LedState.DARK
    return LedState.DIM if brightness < _DIM_SHARE * usual else LedState.DISPLACED


def _foreign_light(seen: Seen, u: float, v: float, reach: float) -> LedState | None:
    """The light at an LED's place with the LEDs off: the spot, or the LED itself; None: none."""
    for _, dark in seen.pairs:
        limit = 2 * float(np.median(dark.pixels[::4, ::4])) + _BRIGHT_SHARE * dark.full_scale
        window = _window(dark, u, v, reach)
        if float(np.percentile(window, _LIT_PERCENTILE)) <= limit:
            continue
        wide = _window(dark, u, v, 2.2 * reach)
        return (
            LedState.HIDDEN if (wide > limit).mean() > 0.5 * (window > limit).mean() else LedState.ALWAYS_LIT
        )
    return None


def _window(frame: Frame, u: float, v: float, reach: float) -> FloatArray:
    top, left = (max(round(place - reach), 0) for place in (v, u))
    return np.asarray(frame.pixels[top : round(v + reach) + 1, left : round(u + reach) + 1], dtype=np.float64)


def _brightness(frame: Frame, u: float, v: float) -> float:
    """The mean level within 2 px."""
    return float(_window(frame, u, v, 2).mean())
