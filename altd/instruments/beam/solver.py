"""Fit of a beam to points on the targets: displacement, yaw, pitch and their sigmas."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from altd.instruments.beam.refraction import Refraction
from altd.instruments.beam.systematics import Warmth, effects_mm
from altd.records import FloatArray, Limits, MeanSpots, TargetPoint
from altd.records.limits import NO_LIMITS

KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
"""Keys of the quantities of a beam that have a sigma."""


def _unknown() -> FloatArray:
    return np.full((4, 4), np.nan)


@dataclass(frozen=True, slots=True)
class Beam:
    """The beam in the unit frame at the reference plane, with combined standard uncertainties (1 sigma).

    ``sigma_random`` is the random part of the sigmas of x, y, yaw and pitch; None: they are entirely random.
    ``line_covariance`` (4, 4) is that of x, slope x, y and slope y, mm; ``line_scatter`` its random part.
    """

    x_mm: float
    y_mm: float
    yaw_deg: float
    pitch_deg: float
    sigma_x_mm: float
    sigma_y_mm: float
    sigma_yaw_deg: float
    sigma_pitch_deg: float
    sigma_random: tuple[float, float, float, float] | None = None
    line_covariance: FloatArray = field(default_factory=_unknown, compare=False, repr=False)
    line_scatter: FloatArray = field(default_factory=_unknown, compare=False, repr=False)

    @property
    def scatter(self) -> tuple[float, float, float, float]:
        """Random part of the sigmas of x, y, yaw and pitch."""
        all_of_it = self.sigma_x_mm, self.sigma_y_mm, self.sigma_yaw_deg, self.sigma_pitch_deg
        return self.sigma_random or all_of_it

    @property
    def slopes(self) -> FloatArray:
        """Slopes (sx, sy)."""
        return np.array([self.yaw_mm_per_m, self.pitch_mm_per_m]) / 1000.0

    @property
    def yaw_mm_per_m(self) -> float:
        """Yaw as a slope, 1000 · tan(yaw)."""
        return _slope_mm_per_m(self.yaw_deg)

    @property
    def pitch_mm_per_m(self) -> float:
        """Pitch as a slope, 1000 · tan(pitch)."""
        return _slope_mm_per_m(self.pitch_deg)


def _slope_mm_per_m(angle_deg: float) -> float:
    """Slope of an angle; NaN if it is not finite: the gate rejects the measurement and names the angle."""
    return 1000.0 * math.tan(math.radians(angle_deg)) if math.isfinite(angle_deg) else math.nan


def joint_covariance_mm2(spots: MeanSpots, points: Sequence[TargetPoint]) -> FloatArray:
    """Covariance (2 T, 2 T) of x and y of T points, mm², one target after the other.

    The scatter of the mean spots is mapped by the maps' Jacobians with all its correlations, because
    vibration moves the spots of all targets together. Print, speckle and map add to it, independently for
    each target.
    """
    size = 2 * len(points)
    of_maps = np.zeros((size, size))
    for index, point in enumerate(points):
        block = slice(2 * index, 2 * index + 2)
        of_maps[block, block] = point.covariance_mm2
    jacobian = joint_jacobian_mm_per_px(points)
    covariance: FloatArray = jacobian @ spots.covariance_px2 @ jacobian.T + of_maps
    return covariance


def joint_jacobian_mm_per_px(points: Sequence[TargetPoint]) -> FloatArray:
    """Jacobian d(x, y)/d(u, v) of all targets, (2 T, 2 T), one block per target."""
    jacobian = np.zeros((2 * len(points), 2 * len(points)))
    for index, point in enumerate(points):
        block = slice(2 * index, 2 * index + 2)
        jacobian[block, block] = point.jacobian_mm_per_px
    return jacobian


_NEWTON_STEPS = 3
"""Newton steps from normal incidence: slopes of 0.25 behind 100 mm of glass are then exact to 1e-15."""


def line_gain(
    z_mm: Sequence[float],
    covariance_mm2: FloatArray,
    reference_plane_mm: float = 0.0,
    displaced_per_slope_mm: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of a line, d(x, slope x, y, slope y)/d(points), (4, 2 T), and its covariance (4, 4).

    ``displaced_per_slope_mm`` (2 T, 2) is from ``Refraction.displaced_mm``; None: without glass. Raises
    numpy.linalg.LinAlgError where no line fits points with that covariance.
    """
    lever = np.asarray(z_mm, dtype=np.float64) - reference_plane_mm
    design = np.zeros((2 * len(lever), 4))
    design[0::2, 0] = design[1::2, 2] = 1.0
    design[0::2, 1] = design[1::2, 3] = lever
    if displaced_per_slope_mm is not None:
        design[:, 1::2] -= displaced_per_slope_mm
    weighted = np.linalg.solve(covariance_mm2, design)
    covariance: FloatArray = np.linalg.inv(design.T @ weighted)
    return covariance @ weighted.T, covariance


def fit_beam(  # noqa: PLR0913  what a beam is uncertain by
    z_mm: Sequence[float],
    points: Sequence[TargetPoint],
    covariance_mm2: FloatArray,
    reference_plane_mm: float = 0.0,
    limits: Limits = NO_LIMITS,
    refraction: Refraction | None = None,
    vibration_mm: FloatArray | None = None,
    warmth: Warmth | None = None,
) -> Beam:
    """Fit a straight line to T ≥ 2 points at the distances ``z_mm``, weighted by their covariance.

    x(z) = x + sx · (z − reference), y likewise; yaw = atan(sx), pitch = atan(sy) (docs/conventions.md). The
    line passes exactly through two points. ``covariance_mm2`` is the random part; ``limits``, and thickness
    and index of glass, add errors that the calibration cannot show. Behind the glass of ``refraction`` the
    points are displaced: the line is that of the beam in front of it. ``vibration_mm`` is from
    ``systematics.vibration_mm``, where the scatter does not show it. ``warmth`` replaces the limit of the
    temperature; ``z_mm`` and ``points`` contain its correction.
    """
    measured = np.array([(point.x_mm, point.y_mm) for point in points])
    if refraction is None:
        gain, covariance = line_gain(z_mm, covariance_mm2, reference_plane_mm)
        line = gain @ measured.ravel()
    else:
        line = np.zeros(4)
        for _ in range(_NEWTON_STEPS):
            displaced, per_slope = refraction.displaced_mm(line[1::2], z_mm)
            gain, covariance = line_gain(z_mm, covariance_mm2, reference_plane_mm, per_slope)
            line = gain @ (measured.ravel() + displaced - per_slope @ line[1::2])
    x, slope_x, y, slope_y = (float(value) for value in line)
    per_slope_deg = math.degrees(1 / (1 + slope_x**2)), math.degrees(1 / (1 + slope_y**2))
    scatter = covariance
    random_x, random_yaw, random_y, random_pitch = _sigmas(np.diag(scatter), per_slope_deg)
    stated = limits != NO_LIMITS or warmth is not None
    effects = effects_mm(limits, z_mm, measured, (slope_x, slope_y), warmth) if stated else {}
    if refraction is not None:
        effects |= refraction.effects_mm(line[1::2], z_mm)
    if vibration_mm is not None:
        effects["vibration"] = vibration_mm
    for columns in effects.values():
        covariance = covariance + (by_effect := gain @ columns) @ by_effect.T
    sigma_x, sigma_yaw, sigma_y, sigma_pitch = _sigmas(np.diag(covariance), per_slope_deg)
    return Beam(
        x_mm=x,
        y_mm=y,
        yaw_deg=math.degrees(math.atan(slope_x)),
        pitch_deg=math.degrees(math.atan(slope_y)),
        sigma_x_mm=sigma_x,
        sigma_y_mm=sigma_y,
        sigma_yaw_deg=sigma_yaw,
        sigma_pitch_deg=sigma_pitch,
        sigma_random=(random_x, random_y, random_yaw, random_pitch),
        line_covariance=covariance,
        line_scatter=scatter,
    )


def _sigmas(variances: FloatArray, per_slope_deg: tuple[float, float]) -> tuple[float, float, float, float]:
    """Sigmas of x, yaw, y and pitch from the variances of x, slope x, y and slope y."""
    x, slope_x, y, slope_y = np.sqrt(variances).tolist()
    return x, slope_x * per_slope_deg[0], y, slope_y * per_slope_deg[1]
