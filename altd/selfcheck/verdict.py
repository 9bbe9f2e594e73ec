"""Effect of a moved picture on a measurement, the verdict of a check, and the correction (thesis 3.4)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from altd.measuring.calibration import Calibration, TargetCalibration
from altd.records import FloatArray, MeanSpots, Value
from altd.selfcheck.drift import drift_of
from altd.selfcheck.records import (
    DriftLimits,
    LedState,
    LedView,
    PartVerdict,
    SelfCheck,
    Similarity,
    TargetDrift,
    Verdict,
)
from altd.vision.flat import Flat


@dataclass(frozen=True, slots=True, eq=False)
class PlaceEffect:
    """Position of the beam on a target, (2,) mm, the error of its measurement, and the error's covariance."""

    true_mm: FloatArray
    error_mm: FloatArray
    covariance_mm2: FloatArray


@dataclass(frozen=True, slots=True)
class WorstEffect:
    """Largest error along x or y, mm, and largest sigma, over all the calibrated area of a target."""

    error_mm: float
    sigma_mm: float


def place_effect(
    target: TargetCalibration, similarity: Similarity, at_px: tuple[float, float] | None
) -> PlaceEffect:
    """Return the effect at the spot's current position; if unknown or unmapped, at the area's middle."""
    middle = target.map.hull_mm.mean(axis=0, keepdims=True)
    then = target.map.to_px(middle) if at_px is None else similarity.then_px(np.array([at_px]))
    point = target.point(float(then[0, 0]), float(then[0, 1]))
    if point is None:
        then = target.map.to_px(middle)
        true_mm, jacobian = middle[0], np.linalg.inv(target.map.jacobian(middle)[0])
    else:
        true_mm, jacobian = np.array([point.x_mm, point.y_mm]), point.jacobian_mm_per_px
    now = similarity.now_px(then)
    covariance = jacobian @ similarity.covariance_at_px2(*then[0].tolist()) @ jacobian.T
    return PlaceEffect(true_mm, jacobian @ (now - then)[0], covariance)


def worst_effect(target: TargetCalibration, similarity: Similarity) -> WorstEffect:
    """Return the largest error and the largest sigma over the calibrated area."""
    points_mm = target.map.dense_mm()
    then = target.map.to_px(points_mm)
    jacobians = np.linalg.inv(target.map.jacobian(points_mm))
    errors = np.einsum("nij,nj->ni", jacobians, similarity.now_px(then) - then)
    covariances = np.array([similarity.covariance_at_px2(u, v) for u, v in then.tolist()])
    variances = np.einsum("nij,njk,nik->ni", jacobians, covariances, jacobians)
    return WorstEffect(float(np.abs(errors).max()), math.sqrt(float(variances.max())))


def beam_effects(
    z_mm: Sequence[float], places: Sequence[PlaceEffect], reference_plane_mm: float
) -> Mapping[str, Value]:
    """Return measured minus true of a beam through two or more targets, by the beam's keys, with sigma."""
    lever = np.asarray(z_mm, dtype=np.float64) - reference_plane_mm
    solve = np.linalg.pinv(np.column_stack([np.ones_like(lever), lever]))
    effects: dict[str, Value] = {}
    for axis, (place, angle) in enumerate((("x_mm", "yaw_deg"), ("y_mm", "pitch_deg"))):
        true = solve @ [each.true_mm[axis] for each in places]
        error = solve @ [each.error_mm[axis] for each in places]
        covariance = solve @ np.diag([each.covariance_mm2[axis, axis] for each in places]) @ solve.T
        effects[place] = Value(float(error[0]), math.sqrt(float(covariance[0, 0])))
        turned = math.atan(true[1] + error[1]) - math.atan(true[1])
        sigma = math.sqrt(float(covariance[1, 1])) / (1.0 + true[1] ** 2)
        effects[angle] = Value(math.degrees(turned), math.degrees(sigma))
    return effects


@dataclass(frozen=True, slots=True, eq=False)
class Compensation:
    """Fitted transforms by target: from the current position of a spot to its position at calibration.

    ``misfit_px`` is, by target, the residual of the LEDs after the transform: no position is known better.
    """

    transforms: Mapping[str, Similarity]
    misfit_px: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class NotCorrected:
    """Reason why nothing is corrected, as text for people."""

    detail: str


def compensation_of(
    check: SelfCheck, calibration: Calibration, limits: DriftLimits
) -> Compensation | NotCorrected:
    """Return the correction of a check's drift; refused if unknown, no similarity, or beyond the limit.

    All targets are corrected or none: half a correction of a direction can be worse than none.
    """
    transforms, misfit_px = {}, {}
    for target in calibration.targets:
        drift = check.targets.get(target.name)
        if drift is None or drift.similarity is None or drift.rms_px is None:
            return NotCorrected(f"{target.name}: the drift is not known")
        if not drift.is_similarity:
            return NotCorrected(f"{target.name}: the drift is not a shift, rotation and scale")
        worst = worst_effect(target, drift.similarity)
        if worst.error_mm > limits.compensate_mm:
            return NotCorrected(
                f"{target.name}: the picture moved by up to {worst.error_mm:.2f} mm, "
                f"{limits.compensate_mm:g} mm are corrected at most"
            )
        if worst.sigma_mm > limits.suspect_mm:
            return NotCorrected(f"{target.name}: the drift is uncertain by {worst.sigma_mm:.3f} mm")
        transforms[target.name] = drift.similarity
        misfit_px[target.name] = drift.rms_px
    return Compensation(transforms, misfit_px)


def flat_now(flat: Flat, transform: Similarity) -> Flat:
    """Return a target's flat as the camera would record it now: print and texture moved with the target.

    Spots must be located through it, because the print under them moved with the picture. A flat that is half
    a pixel off adds more pattern of the print than it removes.
    """
    rows, columns = flat.levels.shape
    levels = cv2.warpAffine(
        flat.levels,
        transform.affine,
        (columns, rows),
        flags=cv2.INTER_LANCZOS4,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return replace(flat, levels=np.asarray(levels, dtype=np.uint8))


def compensated(mean: MeanSpots, compensation: Compensation) -> MeanSpots:
    """Return the mean spots as the calibrated unit would measure them, with the transform's covariance added.

    Apply it to uncorrected mean spots, between the window and the instrument; spots that are located through
    a flat need ``flat_now`` before. Shapes are not changed: a turn of 1° changes them less than their own
    noise. Raises KeyError for a target without a transform.
    """
    px, covariance = mean.px.copy(), mean.covariance_px2.copy()
    for index, name in enumerate(mean.targets):
        transform = compensation.transforms[name]
        block = slice(2 * index, 2 * index + 2)
        covariance[block, block] += transform.covariance_at_px2(*mean.px[index].tolist())
        covariance[block, block] += np.eye(2) * compensation.misfit_px[name] ** 2
        px[index] = transform.then_px(mean.px[index : index + 1])[0]
    return replace(mean, px=px, covariance_px2=covariance)


_NOT_CHECKED = "no frames with the LEDs on and off"
SIGNIFICANT = 7.0
"""Mahalanobis distance from which a drift is not due to chance: 6 in 10⁹ with four degrees of freedom, and
still below 1 in 10,000 if the noise is known only to 15 % (``benchmarks.selfcheck places``)."""
_SIGMAS = 3.0
"""Minimum distance, in sigmas, of a limit from an undetected drift for the verdict to be good."""
_ORDER = (Verdict.GOOD, Verdict.UNKNOWN, Verdict.SUSPECT, Verdict.BAD)


def judge(
    views: Mapping[str, LedView],
    calibration: Calibration,
    at: Mapping[str, tuple[float, float]] | None,
    limits: DriftLimits,
    *,
    previous: Verdict | None = None,
    reference_plane_mm: float = 0.0,
) -> SelfCheck:
    """Return the state of the geometry from LEDs on and off by target. Pure; takes 10 to 50 ms a target.

    ``at`` holds the current positions of the spots, (u, v) px by target, uncorrected; for a target without
    one the middle of the calibrated area counts. ``previous`` is, for the hysteresis, the last verdict that
    was not unknown: after a bad one a check of only a part is unknown, unless that part is bad.
    ``reference_plane_mm`` is the plane of x and y. A target of the calibration that is not in ``views`` makes
    the verdict unknown at best, as does one without LED references; a view of a target that is not in the
    calibration raises KeyError, frames of another size ValueError.
    """
    known = {target.name: target for target in calibration.targets}
    seen = {name: drift_of(name, view, known[name], limits) for name, view in views.items()}
    drifts = {
        name: seen.get(name) or TargetDrift(name, len(known[name].leds_px), 0, (), detail=_NOT_CHECKED)
        for name in known
    }
    worst = {
        name: worst_effect(known[name], drift.similarity)
        for name, drift in drifts.items()
        if drift.similarity is not None
    }
    parts = [
        opinion
        for name, drift in drifts.items()
        for opinion in _of_target(drift, worst.get(name), limits, previous)
    ]
    if len(worst) >= 2:
        z_mm = [known[name].z_mm for name in worst]
        significant = any(_is_significant(drifts[name]) for name in worst)
        parts.append(
            _of_direction(list(worst.values()), max(z_mm) - min(z_mm), significant, limits, previous)
        )
    parts.sort(key=lambda opinion: -_ORDER.index(opinion.verdict))
    verdict = parts[0].verdict
    is_whole = all(opinion.verdict is not Verdict.UNKNOWN for opinion in parts)
    if verdict is Verdict.SUSPECT and not is_whole and previous is Verdict.BAD:
        verdict = Verdict.UNKNOWN  # the LEDs not seen may be the ones that were bad
    return SelfCheck(
        verdict=verdict,
        targets=drifts,
        effects=_effects(drifts, calibration, at or {}, reference_plane_mm),
        reasons=tuple(opinion.reason for opinion in parts if opinion.verdict is not Verdict.GOOD),
        is_whole=is_whole,
        parts=tuple(parts),
    )


def _effects(
    drifts: Mapping[str, TargetDrift],
    calibration: Calibration,
    at: Mapping[str, tuple[float, float]],
    reference_plane_mm: float,
) -> Mapping[str, Value]:
    """Return the effects by the beam's keys; empty unless all of two or more targets were judged."""
    places = []
    for target in calibration.targets:
        drift = drifts[target.name]
        if drift.similarity is None:
            return {}
        places.append(place_effect(target, drift.similarity, at.get(target.name)))
    if len(places) < 2:
        return {}
    return beam_effects([target.z_mm for target in calibration.targets], places, reference_plane_mm)


def _of_target(
    drift: TargetDrift, worst: WorstEffect | None, limits: DriftLimits, previous: Verdict | None
) -> Iterator[PartVerdict]:
    """Yield the verdict on one target; if its LEDs contradict each other, that and any unknown verdict."""
    name = drift.target
    bounds = (limits.suspect_mm, limits.bad_mm)
    if worst is None:
        yield PartVerdict(name, Verdict.UNKNOWN, f"{name}: {drift.detail}", "mm", None, None, *bounds)
        return
    opinion = _against(
        name,
        f"{name}: the picture moved by up to",
        ("mm", worst, *bounds),
        (_is_significant(drift), limits, previous),
    )
    displaced = LedState.DISPLACED in drift.leds
    contradicts = (not drift.is_similarity or displaced) and opinion.verdict is not Verdict.BAD
    if contradicts:
        yield replace(opinion, verdict=Verdict.SUSPECT, reason=f"{name}: {drift.detail}")
    if not contradicts or opinion.verdict is Verdict.UNKNOWN:
        yield opinion


def _of_direction(
    worst: list[WorstEffect],
    distance_mm: float,
    significant: bool,
    limits: DriftLimits,
    previous: Verdict | None,
) -> PartVerdict:
    """Return the verdict on yaw and pitch by all targets' drifts, wherever the beam meets each target."""
    error = sum(effect.error_mm for effect in sorted(worst, key=lambda effect: -effect.error_mm)[:2])
    sigma = math.hypot(*(effect.sigma_mm for effect in worst))
    turned = WorstEffect(math.degrees(error / distance_mm), math.degrees(sigma / distance_mm))
    bounds = (limits.suspect_deg, limits.bad_deg)
    what = "yaw or pitch are off by up to"
    return _against("yaw, pitch", what, ("°", turned, *bounds), (significant, limits, previous))


def _against(
    of: str,
    what: str,
    figures: tuple[str, WorstEffect, float, float],
    state: tuple[bool, DriftLimits, Verdict | None],
) -> PartVerdict:
    """Compare an error and its sigma with (suspect, bad); a verdict once reached ends below a share of it."""
    significant, limits, previous = state
    unit, worst, suspect, bad = figures
    certain = suspect / _SIGMAS
    if previous is Verdict.BAD:
        bad *= limits.release_share
    if previous in (Verdict.SUSPECT, Verdict.BAD):
        suspect *= limits.release_share
    error, sigma = worst.error_mm, worst.sigma_mm
    known = f"{sigma:.3f}" if sigma >= 0.0005 else "below 0.001"
    reason = f"{what} {error:.3f} {unit}, uncertainty {known} {unit}".replace(" °", "°")
    verdict = Verdict.GOOD
    if significant and error > bad:
        verdict = Verdict.BAD
    elif significant and error > suspect:
        verdict = Verdict.SUSPECT
    elif error > suspect or sigma > certain:
        verdict, reason = Verdict.UNKNOWN, f"{reason}: too uncertain to decide"
    return PartVerdict(of, verdict, reason, unit, error, sigma, suspect, bad)


def _is_significant(drift: TargetDrift) -> bool:
    return drift.significance is not None and drift.significance > SIGNIFICANT
