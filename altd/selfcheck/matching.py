"""LEDs of a target among the lights of a check: which light is which LED, and the state of each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import ComplexArray, FloatArray, Frame, PixelArray
from altd.selfcheck.records import LedState

_MIN_AGREEING_FAR = 4
"""Minimum agreement: three of twelve lights match three LEDs by chance if any shift and turn is allowed."""
_MAX_FAR_LIGHTS = 12
TOLERANCE_PX = 2.0
"""Maximum distance of an LED from the similarity of two others that it agrees with; the residuals of the fit
are checked afterwards."""
_USUAL_MOTION_PX = 10.0
_MAX_BASES = 60
_MIN_AGREEING = 3
_RIVAL_BRIGHTNESS = 0.5
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Reach:
    """Maximum deviation of a similarity from none, either way."""

    shift_px: float
    turn_deg: float
    scale: float


_NEAR = _Reach(40.0, 5.0, 0.05)
"""Motion of a camera that comes loose; a symmetric layout would match itself again at 180°."""
_FAR = _Reach(math.inf, 180.0, 0.2)
"""Motion of a camera out of its place, or of another one. LEDs of a target behind it look smaller."""


@dataclass(frozen=True, slots=True, eq=False)
class LightOfLeds:
    """Light of each LED, (n,), -1: none. ``rival``: other lights elsewhere match the layout equally well."""

    lights: Indices
    rival: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """Similarities z → a z + b, (h,) each, with the light that each assigns to each LED, (h, n)."""

    lights: Indices
    counts: Indices
    cost: FloatArray


def match(references_px: FloatArray, lights_px: FloatArray, peaks: FloatArray) -> LightOfLeds:
    """Return which of the lights (m, 2), with their peaks (m,), are the LEDs of the references (n, 2).

    Each pair of LEDs with each pair of lights proposes a similarity; those no camera can make are dropped. Of
    the rest the one with most agreeing lights wins, of equals the one nearest to no motion. If no three
    agree, the layout is searched anywhere in the picture. If it is not found there either, the lights at the
    LEDs' expected positions are accepted.
    """
    least = min(_MIN_AGREEING, len(references_px))
    candidates = _candidates(references_px, lights_px, _NEAR)
    if candidates is None or candidates.counts.max() < least:
        return _far_match(references_px, lights_px, peaks) or LightOfLeds(_in_place(references_px, lights_px))
    return _best_of(candidates, peaks)


def _far_match(references_px: FloatArray, lights_px: FloatArray, peaks: FloatArray) -> LightOfLeds | None:
    """Return the layout of the LEDs anywhere among the brightest lights; None if it is not there."""
    brightest = np.argsort(-peaks, kind="stable")[:_MAX_FAR_LIGHTS]
    candidates = _candidates(references_px, lights_px[brightest], _FAR)
    if candidates is None or candidates.counts.max() < _MIN_AGREEING_FAR:
        return None
    found = _best_of(candidates, peaks[brightest])
    return LightOfLeds(np.where(found.lights >= 0, brightest[found.lights], -1), found.rival)


def _best_of(candidates: _Candidates, peaks: FloatArray) -> LightOfLeds:
    """Return the match of the best candidate."""
    best = int(np.lexsort((candidates.cost, -candidates.counts))[0])
    chosen = candidates.lights[best]
    return LightOfLeds(chosen, _has_rival(candidates, best, peaks))


def _in_place(references_px: FloatArray, lights_px: FloatArray) -> Indices:
    """Return the light at the expected position of each LED, (n,); -1: none."""
    if not len(lights_px):
        return np.full(len(references_px), -1)
    distance = np.hypot(*(references_px[:, None] - lights_px[None]).transpose(2, 0, 1))
    in_place = np.where(distance.min(axis=1) <= TOLERANCE_PX, distance.argmin(axis=1), -1)
    taken, first = np.unique(in_place, return_index=True)  # a light belongs to one LED at most
    alone = np.full_like(in_place, -1)
    alone[first] = taken
    return alone


def _has_rival(candidates: _Candidates, best: int, peaks: FloatArray) -> bool:
    """Return whether about as many other lights, not much dimmer, have the same layout: a second picture."""
    own = candidates.lights[best]
    own_lights = own[own >= 0]
    near = np.flatnonzero(candidates.counts >= max(_MIN_AGREEING, candidates.counts[best] - 1))
    for other in np.unique(candidates.lights[near], axis=0):
        of_other = other[other >= 0]
        shared = np.isin(of_other, own_lights).sum()
        as_bright = np.median(peaks[of_other]) > _RIVAL_BRIGHTNESS * np.median(peaks[own_lights])
        if 2 * shared < len(of_other) and as_bright:
            return True
    return False


def _candidates(references_px: FloatArray, lights_px: FloatArray, reach: _Reach) -> _Candidates | None:
    """Return all similarities within reach from two LEDs to two lights; None without any."""
    if len(references_px) < 2 or len(lights_px) < 2:
        return None
    references, lights = _complex(references_px), _complex(lights_px)
    middle = references.mean()
    first, second = _bases(references)
    k, l = (part.ravel() for part in np.meshgrid(np.arange(len(lights)), np.arange(len(lights))))  # noqa: E741
    k, l = k[k != l], l[k != l]  # noqa: E741
    a = (lights[l] - lights[k])[None] / (references[second] - references[first])[:, None]
    b = lights[k][None] - a * references[first][:, None]
    moved = np.abs(a * middle + b - middle)
    possible = (
        (np.abs(np.abs(a) - 1.0) <= reach.scale)
        & (np.abs(np.angle(a)) <= math.radians(reach.turn_deg))
        & (moved <= reach.shift_px)
    )
    if not possible.any():
        return None
    return _agreement(a[possible], b[possible], references, lights)


def _bases(references: ComplexArray) -> tuple[Indices, Indices]:
    """Return pairs of LEDs, the farthest apart first, ``_MAX_BASES`` at most."""
    every = np.array(list(itertools.combinations(range(len(references)), 2)), dtype=np.int64)
    apart = np.abs(references[every[:, 0]] - references[every[:, 1]])
    every = every[apart > TOLERANCE_PX]
    order = np.argsort(-apart[apart > TOLERANCE_PX], kind="stable")[:_MAX_BASES]
    return every[order, 0], every[order, 1]


def _agreement(
    a: ComplexArray, b: ComplexArray, references: ComplexArray, lights: ComplexArray
) -> _Candidates:
    """Return the lights that agree with each of these similarities; a light belongs to one LED at most."""
    predicted = a[:, None] * references[None] + b[:, None]
    distance = np.abs(predicted[:, :, None] - lights[None, None, :])
    nearest = distance.argmin(axis=2)
    off = np.take_along_axis(distance, nearest[:, :, None], axis=2)[:, :, 0]
    taken = np.where(off <= TOLERANCE_PX, nearest, -1)
    ordered = np.sort(taken, axis=1)
    twice = ((np.diff(ordered, axis=1) == 0) & (ordered[:, 1:] >= 0)).any(axis=1)
    counts = np.where(twice, 0, (taken >= 0).sum(axis=1))
    motion = np.abs(predicted - references[None]).max(axis=1)
    misfit = np.where(taken >= 0, off, 0.0)
    cost = (motion / _USUAL_MOTION_PX) ** 2 + (misfit**2).sum(axis=1) / TOLERANCE_PX**2
    return _Candidates(taken, counts.astype(np.int64), cost)


def _complex(points_px: FloatArray) -> ComplexArray:
    return np.asarray(points_px[:, 0] + 1j * points_px[:, 1], dtype=np.complex128)


_DIM_SHARE = 0.4
_DARK_SHARE = 0.05
MIN_SEEN_SHARE = 0.8
_MARGIN_PX = 3.0
_BRIGHT_SHARE = 0.04
"""Share of full scale, above twice the frame's median, from which light with the LEDs off is not ambient."""
_LIT_PERCENTILE = 97.0
"""Excludes hot pixels: the rim of a spot over an LED moves its position if both reach full scale."""


_UNEVEN_SHARE = 0.012
"""Share of full scale by which a dark frame at one LED is more uneven than twice the median of all."""
_CLIPPED_SHARE = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class SeenLeds:
    """LEDs of a target, as seen in the pairs.

    ``places_px`` (n, 2) are their positions, seen or expected; ``peaks`` (n,) their brightness, NaN where not
    seen; ``share`` (n,) the share of the pairs in which they are seen, 0 to 1.
    """

    pairs: Sequence[tuple[Frame, Frame]]
    places_px: FloatArray
    peaks: FloatArray
    share: FloatArray
    diameter_px: float


def states_of(seen: SeenLeds) -> tuple[LedState, ...]:
    """Return the state of each LED, in order."""
    usual = float(np.nanmedian(seen.peaks)) if np.isfinite(seen.peaks).any() else 0.0
    touched = _touched(seen)
    return tuple(
        LedState.HIDDEN if touched[index] and state is LedState.USED else state
        for index, state in enumerate(_state(seen, index, usual) for index in range(len(seen.places_px)))
    )


def _touched(seen: SeenLeds) -> npt.NDArray[np.bool_]:
    """Return over which LEDs, (n,), faint light that others do not have brings some pixels to full scale.

    Clipping on one side moves the position of an LED: the rim of a spot by 0.1 px.
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


def _state(seen: SeenLeds, index: int, usual: float) -> LedState:
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
    if seen.share[index] >= MIN_SEEN_SHARE:
        return LedState.DIM if peak < _DIM_SHARE * usual else LedState.USED
    if seen.share[index] > 0:
        return LedState.UNSTEADY
    brightness = np.mean([_brightness(lit, u, v) - _brightness(dark, u, v) for lit, dark in seen.pairs])
    if not usual or brightness < _DARK_SHARE * usual:
        return LedState.DARK
    return LedState.DIM if brightness < _DIM_SHARE * usual else LedState.DISPLACED


def _foreign_light(seen: SeenLeds, u: float, v: float, reach: float) -> LedState | None:
    """Return the state by light at an LED with the LEDs off: the spot, or the LED itself; None: no light."""
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
    """Return the mean level within 2 px."""
    return float(_window(frame, u, v, 2).mean())
