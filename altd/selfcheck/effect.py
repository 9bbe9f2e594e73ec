"""What a moved picture makes of a measurement, through the maps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from altd.measuring.calibration import TargetCalibration
from altd.records import FloatArray, Value
from altd.selfcheck.records import Similarity


@dataclass(frozen=True, slots=True, eq=False)
class PlaceEffect:
    """Where the beam is on a target, (2,) mm, by how much it is measured off, and that one's covariance."""

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
