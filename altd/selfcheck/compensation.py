"""A moved picture: its effect on a measurement, and taking it out of the pixel coordinates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from altd.measuring.calibration import Calibration, TargetCalibration
from altd.records import FloatArray, MeanSpots, Value
from altd.selfcheck.records import Limits, SelfCheck, Similarity
from altd.vision.flat import Flat


@dataclass(frozen=True, slots=True, eq=False)
class PlaceEffect:
    """The beam's place on a target, (2,) mm, the error of its measurement, and the covariance of that."""

    true_mm: FloatArray
    error_mm: FloatArray
    covariance_mm2: FloatArray


@dataclass(frozen=True, slots=True)
class WorstEffect:
    """Of all the calibrated area of a target: the largest error along x or y, mm, and the largest sigma."""

    error_mm: float
    sigma_mm: float


def place_effect(
    target: TargetCalibration, similarity: Similarity, at_px: tuple[float, float] | None
) -> PlaceEffect:
    """The effect where the spot is seen now; without a place, or outside the map, in the area's middle."""
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
    """The largest error, and the largest sigma, over the calibrated area."""
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
    """Measured minus true of a beam through two targets or more, by the beam's keys, with sigma."""
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
    """The fitted transforms by target: from where a spot is seen now to where it would have been then.

    ``misfit_px`` is, by target, what the LEDs leave beside the transform: no place is known better.
    """

    transforms: Mapping[str, Similarity]
    misfit_px: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Refused:
    """Why nothing is corrected, in words for people."""

    detail: str


def compensation_of(check: SelfCheck, calibration: Calibration, limits: Limits) -> Compensation | Refused:
    """The correction of a check's drift; refused where it is unknown, no similarity, or beyond the limit.

    All targets are corrected or none: half a correction of a direction can be worse than none.
    """
    transforms, misfit_px = {}, {}
    for target in calibration.targets:
        drift = check.targets.get(target.name)
        if drift is None or drift.similarity is None or drift.rms_px is None:
            return Refused(f"{target.name}: the drift is not known")
        if not drift.is_similarity:
            return Refused(f"{target.name}: the drift is no shift, turn and scale")
        worst = worst_effect(target, drift.similarity)
        if worst.error_mm > limits.compensate_mm:
            return Refused(
                f"{target.name}: the picture moved by up to {worst.error_mm:.2f} mm, "
                f"{limits.compensate_mm:g} mm are corrected at most"
            )
        if worst.sigma_mm > limits.suspect_mm:
            return Refused(f"{target.name}: the drift is known to {worst.sigma_mm:.3f} mm only")
        transforms[target.name] = drift.similarity
        misfit_px[target.name] = drift.rms_px
    return Compensation(transforms, misfit_px)


def flat_now(flat: Flat, transform: Similarity) -> Flat:
    """A target's flat as the camera would record it now: print and texture moved with the target.

    A spot is to be located through it, for the print under it is where the picture is. A flat that is half a
    pixel off makes more pattern of the print than it removes (docs/selfcheck.md).
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
    """The mean spots as the calibrated unit would have seen them, with the transform's covariance added.

    To be applied to uncorrected mean spots, between the window and the instrument; spots that a flat helps to
    locate want ``flat_now`` before. Shapes stay as they are:
    a turn of 1° changes them less than their own noise. Raises KeyError for a target without a transform.
    """
    px, covariance = mean.px.copy(), mean.covariance_px2.copy()
    for index, name in enumerate(mean.targets):
        transform = compensation.transforms[name]
        block = slice(2 * index, 2 * index + 2)
        covariance[block, block] += transform.covariance_at_px2(*mean.px[index].tolist())
        covariance[block, block] += np.eye(2) * compensation.misfit_px[name] ** 2
        px[index] = transform.then_px(mean.px[index : index + 1])[0]
    return replace(mean, px=px, covariance_px2=covariance)
