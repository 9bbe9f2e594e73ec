"""From a visit to a place: where the beam met the opaque target, with the parts of its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from altd.instruments.row.rounds import Visit
from altd.measuring.averaging import mean_spots
from altd.measuring.calibration import TargetCalibration
from altd.measuring.spot_shape import (
    BIAS_PER_MM2,
    BIAS_PER_STRETCH,
    EXPLAINED_SIGMAS,
    STRETCH_SIGMA,
    shape_in_mm,
    unlike_a_laser,
)
from altd.reasons import Reason
from altd.records import Fault, FloatArray, FrameSet, Limits, MeanSpots, TargetPoint

_SIGMAS_PER_DIAMETER = 4.0
"""Standard deviations of a Gaussian beam per 1/e² diameter."""
_UNKNOWN_RADIUS_MM = 2.5
_MAX_DIAMETER_MM = 23.0
"""Maximum diameter of a spot: that of a red beam of 3.7 mm 100 m behind its waist, by diffraction."""
_EXPLAINED_SIGMAS = 6.0
"""Difference in size up to which a spot is of the calibrated size: some 3 %, which displace by 2 µm."""
_PER_CURVATURE = 4.3
"""Displacement of a fitted centre by the curvature of the map, per ½ s² ∇²: 1 for the first moment. The fit
weighs the foot of a spot more, as texture disturbs it less. Measured on two simulators, without a flat."""
_FALL_OFF_REACH_MM = 30.0
"""Distance from the target's middle, or way of a spot, that adds a sigma of BIAS_PER_MM2: a lens's fall-off
(cos⁴) displaces a spot in proportion to its distance from the axis. Measured on the same simulators."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamPlace:
    """Intersection of the beam with a target at ``t_ns``, (2,) mm.

    ``random_mm2`` (2, 2) is the part that scatters from visit to visit, ``covariance_mm2`` the whole
    covariance. ``excess_mm2`` is the variance by light that one spot does not explain. ``spot_sigma_mm`` is
    the standard deviation of the light's profile: two places closer than that share most of the target's
    texture. ``stretch`` is the two components of ``shape_in_mm``; None: not known.
    """

    t_ns: int
    frames: int
    mm: FloatArray
    random_mm2: FloatArray
    covariance_mm2: FloatArray
    excess_mm2: float
    spot_sigma_mm: float
    mm_per_px: FloatArray
    stretch: tuple[float, float] | None = None


def place_of(
    visit: Visit, calibration: TargetCalibration, limits: Limits, exposures: int
) -> BeamPlace | tuple[Fault, ...]:
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
    if isinstance(why := calibration.cross_checked(point, u_px, v_px), str):
        return (Fault(Reason.IMPLAUSIBLE, name, why),)
    shape = mean.shapes[0] if mean.shapes else None
    stretch = None
    if shape is not None:
        shape_mm = shape_in_mm(shape, point.jacobian_mm_per_px)
        stretch = float(shape_mm[1]), float(shape_mm[2])
        if (unlike := unlike_a_laser(shape_mm, calibration.spot.shape, _MAX_DIAMETER_MM)) is not None:
            return (unlike.fault(name),)
    return replace(_place(mean, point, calibration, limits), stretch=stretch)


def _place(mean: MeanSpots, point: TargetPoint, calibration: TargetCalibration, limits: Limits) -> BeamPlace:
    jacobian = point.jacobian_mm_per_px
    mm_per_px = float(np.sqrt(abs(np.linalg.det(jacobian))))
    excess_px = mean.excess_px[0] if mean.excess_px else 0.0
    excess_mm2 = (excess_px * mm_per_px) ** 2
    random = jacobian @ (mean.covariance_px2 - excess_px**2 * np.eye(2)) @ jacobian.T
    mm = np.array([point.x_mm, point.y_mm])
    of_stage = np.diag(stage_variances_mm2(limits, mm))
    shape = mean.shapes[0] if mean.shapes else None
    radius_mm = _UNKNOWN_RADIUS_MM
    if shape is not None:
        diameter_px = 4.0 / (shape.a * shape.c - shape.b**2) ** 0.25
        radius_mm = diameter_px * mm_per_px / _SIGMAS_PER_DIAMETER
    wider_mm2 = _wider_mm2(calibration, radius_mm)
    around = calibration.map.to_px(mm + radius_mm * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]))
    laplacian = (around[1:].sum(axis=0) - 4.0 * around[0]) / radius_mm**2
    mm -= jacobian @ laplacian * (_PER_CURVATURE * wider_mm2 / _SIGMAS_PER_DIAMETER**2 / 2.0)
    fall_off_mm = BIAS_PER_MM2 * wider_mm2 * math.hypot(1.0, *mm / _FALL_OFF_REACH_MM)
    doubts_mm2 = excess_mm2 + fall_off_mm**2
    total = random + point.covariance_mm2 + doubts_mm2 * np.eye(2) + of_stage
    return BeamPlace(mean.t_ns, mean.frames, mm, random, total, excess_mm2, radius_mm, jacobian)


def _wider_mm2(calibration: TargetCalibration, spot_sigma_mm: float) -> float:
    """Squared diameter of a spot beyond that of the calibrated spots; 0 within their scatter.

    A map holds for spots of the calibrated size: its curvature and the lens's fall-off displace others in
    proportion to this.
    """
    if (known := calibration.spot.shape) is None:
        return 0.0
    log_ratio = math.log(spot_sigma_mm * _SIGMAS_PER_DIAMETER / 2.0) - known.mean[0]
    log_ratio = math.copysign(max(abs(log_ratio) - _EXPLAINED_SIGMAS * known.sigma[0], 0.0), log_ratio)
    return 4.0 * math.exp(2.0 * known.mean[0]) * math.expm1(2.0 * log_ratio)


def stage_variances_mm2(limits: Limits, mm: FloatArray) -> FloatArray:
    """Variances (2,) of a place or a distance by the uncertain scale and squareness of the stage, mm²."""
    scale, square = limits.stage_scale_ppm or 0.0, limits.stage_square_mrad or 0.0
    variances: FloatArray = (scale * 1e-6 * mm) ** 2 + (square * 1e-3 * mm[::-1]) ** 2
    return variances


def systematic_mm2(
    calibration: TargetCalibration, limits: Limits, now: BeamPlace, before: BeamPlace
) -> FloatArray:
    """Covariance (2, 2) mm² of the part of a spot's movement between two places that is not random.

    The map's error cancels as far as it is the same at both places, and the target's texture as far as the
    spot covers the same of it. For weights exp(−r²/2s²) the centroid errors by white texture, d apart, are
    correlated by exp(−d²/4s²)(I − d dᵀ/2s²). The other parts of the map's noise, errors of the stage and of
    the scan's frames, do not enter a difference. Unexplained light and the effect of a spot's size cancel as
    far as they are unchanged.
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
    wider_mm2, before_mm2 = (_wider_mm2(calibration, of.spot_sigma_mm) for of in (now, before))
    shares = math.hypot(1.0, *now.mm / _FALL_OFF_REACH_MM), math.hypot(*moved / _FALL_OFF_REACH_MM)
    changed += BIAS_PER_MM2**2 * math.hypot((wider_mm2 - before_mm2) * shares[0], wider_mm2 * shares[1]) ** 2
    changed += _stretched_mm2(calibration, now, before, shared)
    covariance: FloatArray = of_map + changed * np.eye(2) + np.diag(stage_variances_mm2(limits, moved))
    return covariance


def _stretched_mm2(calibration: TargetCalibration, now: BeamPlace, before: BeamPlace, shared: float) -> float:
    """Variance (mm²) by light that has stretched a spot since; ``shape_agreement`` compares two targets so.

    The texture stretches a spot too, and alike where the spot stays.
    """
    known = calibration.spot.shape
    if known is None or now.stretch is None or before.stretch is None:
        return 0.0
    radius2_mm2 = 4.0 * now.spot_sigma_mm**2
    by_texture = 0.5 * (known.sigma[1] + known.sigma[2]) ** 2 * (1.0 - shared)
    by_noise = float(np.trace(now.random_mm2 + before.random_mm2)) / radius2_mm2
    variance = by_texture + by_noise + 2.0 * STRETCH_SIGMA**2
    unexplained = math.dist(now.stretch, before.stretch) ** 2 - EXPLAINED_SIGMAS**2 * variance
    return BIAS_PER_STRETCH**2 * radius2_mm2 * max(unexplained, 0.0)
