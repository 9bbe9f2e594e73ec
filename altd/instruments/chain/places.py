"""From a visit to a place: where the beam met the opaque target, with the parts of its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from altd.instruments.chain.rounds import Visit
from altd.measuring.averaging import mean_spots
from altd.measuring.calibration import TargetCalibration
from altd.measuring.spot_shape import shape_doubts_mm
from altd.reasons import Reason
from altd.records import Fault, FloatArray, FrameSet, Limits, MeanSpots, TargetPoint

_SIGMAS_PER_DIAMETER = 4.0
"""Standard deviations of a Gaussian beam per 1/e² diameter."""
_UNKNOWN_RADIUS_MM = 2.5


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Intersection of the beam with a target at ``t_ns``, (2,) mm.

    ``random_mm2`` (2, 2) is the part that scatters from visit to visit, ``covariance_mm2`` the whole
    covariance. ``excess_mm2`` is the variance by light that one spot does not explain. ``spot_sigma_mm`` is
    the standard deviation of the light's profile: two places closer than that share most of the target's
    texture.
    """

    t_ns: int
    frames: int
    mm: FloatArray
    random_mm2: FloatArray
    covariance_mm2: FloatArray
    excess_mm2: float
    spot_sigma_mm: float
    mm_per_px: FloatArray


def place_of(
    visit: Visit, calibration: TargetCalibration, limits: Limits, exposures: int
) -> Place | tuple[Fault, ...]:
    """Return the place of a visit, or the faults that prevent it."""
    name = visit.target
    frame_sets = [FrameSet(one.sequence, one.t_ns, {name: one.spot}) for one in visit.own(exposures)]
    if not frame_sets:
        return (Fault(Reason.CAMERA_SILENT, name),)
    mean = mean_spots(frame_sets, (name,), exposures)
    if not isinstance(mean, MeanSpots):
        return mean
    u_px, v_px = map(float, mean.px[0])
    point = calibration.point(u_px, v_px)
    if point is None:
        detail = f"{name} spot at u {u_px:.1f} v {v_px:.1f} px lies outside the calibrated area"
        return (Fault(Reason.OUT_OF_RANGE, detail=detail),)
    if why := calibration.implausible(point, u_px, v_px):
        return (Fault(Reason.IMPLAUSIBLE, name, why),)
    doubts_mm = shape_doubts_mm(mean, [point], [calibration.spot.shape])
    if isinstance(doubts_mm, Fault):
        return (doubts_mm,)
    return _place(mean, point, float(doubts_mm[0]), limits)


def _place(mean: MeanSpots, point: TargetPoint, doubt_mm: float, limits: Limits) -> Place:
    jacobian = point.jacobian_mm_per_px
    mm_per_px = float(np.sqrt(abs(np.linalg.det(jacobian))))
    excess_px = mean.excess_px[0] if mean.excess_px else 0.0
    excess_mm2 = (excess_px * mm_per_px) ** 2 + doubt_mm**2
    random = jacobian @ (mean.covariance_px2 - excess_px**2 * np.eye(2)) @ jacobian.T
    mm = np.array([point.x_mm, point.y_mm])
    of_stage = np.diag(stage_variances_mm2(limits, mm))
    shape = mean.shapes[0] if mean.shapes else None
    radius_mm = _UNKNOWN_RADIUS_MM
    if shape is not None:
        diameter_px = 4.0 / (shape.a * shape.c - shape.b**2) ** 0.25
        radius_mm = diameter_px * mm_per_px / _SIGMAS_PER_DIAMETER
    total = random + point.covariance_mm2 + excess_mm2 * np.eye(2) + of_stage
    return Place(mean.t_ns, mean.frames, mm, random, total, excess_mm2, radius_mm, jacobian)


def stage_variances_mm2(limits: Limits, mm: FloatArray) -> FloatArray:
    """Variances (2,) of a place or a distance by the uncertain scale and squareness of the stage, mm²."""
    scale, square = limits.stage_scale_ppm or 0.0, limits.stage_square_mrad or 0.0
    variances: FloatArray = (scale * 1e-6 * mm) ** 2 + (square * 1e-3 * mm[::-1]) ** 2
    return variances


def systematic_mm2(calibration: TargetCalibration, limits: Limits, now: Place, before: Place) -> FloatArray:
    """Covariance (2, 2) mm² of the part of a spot's movement between two places that is not random.

    The map's error cancels as far as it is the same at both places, and the target's texture as far as the
    spot covers the same of it. For weights exp(−r²/2s²) the centroid errors by white texture, d apart, are
    correlated by exp(−d²/4s²)(I − d dᵀ/2s²). The other parts of the map's noise, errors of the stage and of
    the scan's frames, do not enter a difference. Unexplained light cancels as far as it is unchanged.
    """
    moved = now.mm - before.mm
    s2 = now.spot_sigma_mm * before.spot_sigma_mm
    shared = float(np.exp(-moved @ moved / (4.0 * s2)))
    correlation = shared * (np.eye(2) - np.outer(moved, moved) / (2.0 * s2))
    spot = calibration.spot
    texture = (spot.pattern_px or math.inf) / max(spot.noise_px, 1e-9)
    differs = min(texture**2, 1.0) * (np.eye(2) - correlation)
    of_map = calibration.inverse.difference_mm2(now.mm, before.mm, now.mm_per_px, differs)
    changed = (math.sqrt(now.excess_mm2) - math.sqrt(before.excess_mm2)) ** 2
    changed += (now.excess_mm2 + before.excess_mm2) * (1.0 - shared)
    covariance: FloatArray = of_map + changed * np.eye(2) + np.diag(stage_variances_mm2(limits, moved))
    return covariance
