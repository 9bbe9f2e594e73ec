"""Comparison of one target's LEDs with their references: which are present, and how the picture moved."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from altd.measuring.calibration import TargetCalibration
from altd.records import FloatArray, Frame, counted
from altd.selfcheck.lights import Lights, lights_of, pairs
from altd.selfcheck.matching import MIN_SEEN_SHARE, TOLERANCE_PX, Indices, SeenLeds, match, states_of
from altd.selfcheck.records import DriftLimits, LedState, LedView, Similarity, TargetDrift, design_rows

Chosen = npt.NDArray[np.bool_]

_RASTER_PX = 0.003
"""Displacement of an LED's measured position when its alignment to the pixel raster changes: 0.0025 px rms
over 144 displaced LEDs of two simulated units."""
_PRIOR_RATIO, _PRIOR_FREEDOM = 1.3, 8.0
"""Prior before the pairs are known: positions scatter 1.15 times as much as the frames' noise predicts."""
_MISFIT_SIGMAS = 4.5
_MODEL_SHARE = 0.05
"""Share of a motion by which a lens bends it from one LED to the next; more is no similarity."""
_MISFIT_LIMIT_SHARE = 0.25
_MANY_LIGHTS = 3
_MIN_RADIUS_PX = 20.0
"""Minimum rms distance of the LEDs from their centroid; nearer ones determine no turn or scale."""


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """LEDs' positions by pair, (p, n, 2) px, NaN where not seen, with their sigma (p, n) and peak (p, n)."""

    px: FloatArray
    sigma_px: FloatArray
    peak: FloatArray
    diameter_px: float
    foreign: tuple[tuple[float, float, bool], ...]
    rival: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Noise:
    """Squared ratio of the scatter to the frames' noise; variance of the motion common to a pair, px²."""

    ratio2: float
    common_px2: float


def drift_of(name: str, view: LedView, target: TargetCalibration, limits: DriftLimits) -> TargetDrift:
    """Return the drift of one target from its frames; raises ValueError for frames of another size."""
    references = np.asarray(target.leds_px, dtype=np.float64)
    if any(frame.pixels.shape != (target.height, target.width) for frame in (*view.lit, *view.dark)):
        raise ValueError(f"{name}: frames are not {target.width} × {target.height} px")
    number = len(references)
    if number < limits.min_leds:
        states = (LedState.DARK,) * number
        text = f"the calibration knows {counted(number, 'LED')}, {limits.min_leds} are needed"
        return TargetDrift(name, number, 0, states, detail=text)
    if _radius_px(references) < _MIN_RADIUS_PX:
        text = "the calibration's LEDs lie all in one place"
        return TargetDrift(name, number, 0, (LedState.DARK,) * number, detail=text)
    taken = list(pairs(view))
    places = _places(taken, references)
    share = np.isfinite(places.px[:, :, 0]).mean(axis=0) if len(places.px) else np.zeros(number)
    seen = share >= MIN_SEEN_SHARE
    means = np.full((number, 2), np.nan)
    if seen.any():
        means[seen] = np.nanmean(places.px[:, seen], axis=0)
    about, radius = references.mean(axis=0), _radius_px(references)
    expected = references
    if seen.sum() >= 2:
        first = fit_similarity(references[seen], means[seen], np.ones(int(seen.sum())), about, radius)
        expected = first.similarity.now_px(references)
    peaks = np.full(number, np.nan)
    if seen.any():
        peaks[seen] = np.nanmean(places.peak[:, seen], axis=0)
    states = states_of(SeenLeds(taken, expected, peaks, share, places.diameter_px))
    used = np.array([state is LedState.USED for state in states])
    if places.rival:
        used[:] = False
    found = int(used.sum())
    foreign = tuple((u, v) for u, v, _ in places.foreign)
    if found < limits.min_leds:
        text = _sentence(states, places, found, few=True)
        return TargetDrift(name, number, found, states, foreign, detail=text)
    noise = _noise(places, used)
    claimed = np.sqrt(np.nanmean(places.sigma_px[:, used] ** 2, axis=0) * noise.ratio2)
    in_check = claimed / math.sqrt(len(places.px))
    sigma = np.sqrt(in_check**2 + claimed**2 + _RASTER_PX**2)
    fitted = fit_similarity(references[used], means[used], sigma, about, radius)
    rms = float(np.sqrt(np.mean(fitted.residuals_px**2)))
    is_similarity = _is_similarity(fitted, references[used], means[used], sigma, target, limits)
    similarity = _with_covariance(fitted, noise, len(places.px))
    vector = similarity.vector
    significance = math.sqrt(float(vector @ np.linalg.solve(similarity.covariance, vector)))
    detail = _sentence(states, places, found, few=False)
    if not is_similarity:
        detail = f"the LEDs' places disagree with any shift, turn and scale by {rms:.2f} px; {detail}"
    return TargetDrift(
        target=name,
        leds_expected=number,
        leds_found=found,
        leds=states,
        foreign_px=foreign,
        similarity=similarity,
        rms_px=rms,
        significance=significance,
        is_similarity=is_similarity,
        detail=detail.rstrip("; "),
    )


def _places(taken: list[tuple[Frame, Frame]], references: FloatArray) -> _Places:
    """Return the LEDs in each pair that shows enough of them to identify them."""
    shape = len(references)
    px, sigma, peak, diameters = [], [], [], []
    lights: list[Lights] = []
    matched: list[Indices] = []
    rivals = 0
    for lit, dark in taken:
        found = lights_of(lit, dark, references)
        matches = match(references, found.px, found.peak)
        lights.append(found)
        have = matches.lights >= 0
        matched.append(matches.lights[have])
        if not have.any():
            continue
        rivals += matches.rival
        which = matches.lights[have]
        px.append(_spread(found.px[which], have, (shape, 2)))
        sigma.append(_spread(found.sigma_px[which], have, (shape,)))
        peak.append(_spread(found.peak[which], have, (shape,)))
        diameters += found.diameter_px[which].tolist()
    return _Places(
        px=np.array(px).reshape(-1, shape, 2),
        sigma_px=np.array(sigma).reshape(-1, shape),
        peak=np.array(peak).reshape(-1, shape),
        diameter_px=float(np.median(diameters)) if diameters else 20.0,
        foreign=_foreign(lights, matched),
        rival=2 * rivals > len(px) > 0,
    )


def _spread(values: FloatArray, have: Chosen, shape: tuple[int, ...]) -> FloatArray:
    """Return values of some of the LEDs among all of them; NaN for the others."""
    among = np.full(shape, np.nan)
    among[have] = values
    return among


def _foreign(lights: list[Lights], matched: list[Indices]) -> tuple[tuple[float, float, bool], ...]:
    """Return the positions of lights that are no LED, and whether they shine in every pair."""
    groups: list[tuple[FloatArray, int]] = []
    for found, which in zip(lights, matched, strict=True):
        for place in np.delete(found.px, which, axis=0):
            for index, (known, count) in enumerate(groups):
                if np.hypot(*(place - known)) <= 2 * TOLERANCE_PX:
                    groups[index] = known, count + 1
                    break
            else:
                groups.append((place, 1))
    return tuple((float(place[0]), float(place[1]), count >= len(lights)) for place, count in groups)


def _noise(places: _Places, used: Chosen) -> _Noise:
    """Return the scatter of the used LEDs' positions from pair to pair: of each alone and of all together."""
    px, sigma = places.px[:, used], places.sigma_px[:, used]
    deviation = px - np.nanmean(px, axis=0)
    common = np.nanmean(deviation, axis=1)
    own = (deviation - common[:, None]) / sigma[:, :, None]
    pairs_less_one, leds_less_one = len(px) - 1, px.shape[1] - 1
    freedom = 2 * pairs_less_one * leds_less_one
    ratio2 = (_PRIOR_FREEDOM * _PRIOR_RATIO + float(np.nansum(own**2))) / (_PRIOR_FREEDOM + freedom)
    if pairs_less_one == 0:
        return _Noise(ratio2, 0.0)
    scatter = float((common**2).sum()) / (2 * pairs_less_one)
    by_chance = ratio2 * float(np.nanmean(sigma**2)) / px.shape[1]
    excess = scatter - by_chance * (1.0 + 3.0 / math.sqrt(pairs_less_one))
    return _Noise(ratio2, scatter if excess > 0.0 else 0.0)


def _with_covariance(fitted: Fitted, noise: _Noise, pairs_seen: int) -> Similarity:
    """Add the residuals and the picture's vibration; the reference is assumed to be of one pair."""
    found = fitted.similarity
    stretch = max(1.0, fitted.chi2 / fitted.degrees_of_freedom) if fitted.degrees_of_freedom else 1.0
    covariance = found.covariance * stretch
    covariance[:2, :2] += np.eye(2) * noise.common_px2 * (1.0 + 1.0 / pairs_seen)
    return replace(found, covariance=covariance)


def _is_similarity(
    fitted: Fitted,
    then_px: FloatArray,
    now_px: FloatArray,
    sigma_px: FloatArray,
    target: TargetCalibration,
    limits: DriftLimits,
) -> bool:
    """Return whether noise, or slight bending of the motion by a lens, explains the residuals."""
    motion = np.hypot(*(now_px - then_px).T)
    allowed = np.sqrt(sigma_px**2 + (_MODEL_SHARE * motion) ** 2)
    chi2 = float(np.sum((fitted.residuals_px / allowed[:, None]) ** 2))
    if chi2 <= chi2_limit(fitted.degrees_of_freedom, _MISFIT_SIGMAS):
        return True
    middle = target.map.hull_mm.mean(axis=0, keepdims=True)
    mm_per_px = 1.0 / math.sqrt(abs(float(np.linalg.det(target.map.jacobian(middle)[0]))))
    worst_mm = float(np.hypot(*fitted.residuals_px.T).max()) * mm_per_px
    return worst_mm <= _MISFIT_LIMIT_SHARE * limits.suspect_mm


def _radius_px(references: FloatArray) -> float:
    return float(np.sqrt(np.sum((references - references.mean(axis=0)) ** 2, axis=1).mean()))


def _sentence(states: tuple[LedState, ...], places: _Places, found: int, *, few: bool) -> str:
    """Return remarks on the LEDs for a person, empty if all are good."""
    parts = []
    if places.rival:
        parts.append("two groups of lights look like the LEDs")
    elif few:
        parts.append(f"{found} of {len(states)} LEDs can be used" if found else "no LED can be used")
        if len(places.foreign) >= _MANY_LIGHTS:
            parts.append("the lights do not lie as the LEDs did")
    for state in LedState:
        which = [str(index + 1) for index, each in enumerate(states) if each is state]
        if which and state is not LedState.USED:
            parts.append(f"LED {', '.join(which)}: {state.replace('_', ' ')}")
    for u, v, always in places.foreign:
        when = "with the LEDs" if always else "without the LEDs"
        parts.append(f"a light that is not an LED shines {when} at u {u:.0f} v {v:.0f} px")
    return "; ".join(parts)


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Similarity, residuals (n, 2) px of the LEDs, their weighted square sum and its degrees of freedom."""

    similarity: Similarity
    residuals_px: FloatArray
    chi2: float
    degrees_of_freedom: int


def fit_similarity(
    then_px: FloatArray, now_px: FloatArray, sigma_px: FloatArray, about_px: FloatArray, radius_px: float
) -> Fitted:
    """Fit shift, turn and scale that map LEDs at ``then_px`` (n, 2) to ``now_px`` (n, 2), n ≥ 2.

    ``sigma_px`` (n,) is the standard deviation of each LED's motion per axis, reference and check together. A
    similarity is linear in scale·cos and scale·sin. Raises LinAlgError if all LEDs are in one place.
    """
    right, down = (then_px - about_px).T
    weight = np.repeat(1.0 / sigma_px, 2)
    design = np.zeros((2 * len(then_px), 4))
    design[0::2] = np.column_stack([np.ones_like(right), np.zeros_like(right), right, -down])
    design[1::2] = np.column_stack([np.zeros_like(right), np.ones_like(right), down, right])
    normal = (design * weight[:, None] ** 2).T @ design
    shift_u, shift_v, cos, sin = np.linalg.solve(
        normal, (design * weight[:, None] ** 2).T @ (now_px - about_px).ravel()
    )
    rows = np.concatenate([design_rows(u, v) for u, v in zip(right, down, strict=True)])
    covariance = np.linalg.inv((rows * weight[:, None] ** 2).T @ rows)
    similarity = Similarity(
        about_px=(float(about_px[0]), float(about_px[1])),
        shift_px=(float(shift_u), float(shift_v)),
        turn_deg=math.degrees(math.atan2(sin, cos)),
        scale_ppm=1e6 * (math.hypot(cos, sin) - 1.0),
        covariance=covariance,
        radius_px=radius_px,
    )
    residuals = now_px - similarity.now_px(then_px)
    return Fitted(
        similarity, residuals, float(np.sum((residuals / sigma_px[:, None]) ** 2)), 2 * len(then_px) - 4
    )


def chi2_limit(degrees_of_freedom: int, sigmas: float) -> float:
    """Return the χ² that chance exceeds as rarely as a Gaussian deviate its ``sigmas`` (Wilson–Hilferty)."""
    if degrees_of_freedom == 0:
        return math.inf
    ninth = 2.0 / (9.0 * degrees_of_freedom)
    return degrees_of_freedom * (1.0 - ninth + sigmas * math.sqrt(ninth)) ** 3
