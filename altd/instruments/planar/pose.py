"""Pose of the plate from the centres of its LEDs (Eq. 2.59), its covariance, and errors at known poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from altd.instruments.planar.fitting import PlaneFit, PlateView, fit_plane, radius_mm
from altd.instruments.planar.layout import Pose, placed_mm, rigid_pose, rotation, wrapped_deg
from altd.instruments.planar.plane import Model
from altd.mapping.camera_model import light_centre_shift_px
from altd.records import FloatArray

_ITERATIONS = 4
_PRIOR_DEGREES = 10.0
"""Degrees of freedom with which the calibration's noise counts, in addition to those of the LEDs."""
_MAX_MISFIT = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class SolvedPose:
    """A pose (a mm, b mm, φ °), its covariance (3, 3) and the random part of that.

    ``misfit`` is the residuals' chi-square as a standard normal deviate (Wilson and Hilferty's cube root).
    """

    pose: Pose
    covariance: FloatArray
    scatter: FloatArray
    misfit: float

    @property
    def fits(self) -> bool:
        """Whether the LEDs fit a rigid plate."""
        return self.misfit <= _MAX_MISFIT


def solve_pose(
    fit: PlaneFit,
    disc_mm: float,
    leds: npt.NDArray[np.intp],
    centres_px: FloatArray,
    noise_px: FloatArray,
) -> SolvedPose:
    """Solve the pose by generalised least squares over two or more LEDs.

    ``noise_px`` (n,) is the noise of each centre that remains after averaging. Errors of the camera and of
    the LED positions are common to all LEDs: their covariance enters the weights and the result. Where the
    LEDs agree worse than expected, the covariance grows accordingly (Birge's ratio, with the calibration's
    noise as prior).
    """
    moment_mm2 = disc_mm**2 / 16
    pose = rigid_pose(fit.leds_mm[leds], fit.camera.to_mm(centres_px))
    scatter_px2 = np.diag(np.repeat(np.square(noise_px) + fit.noise_px**2, 2))
    for _ in range(_ITERATIONS):
        at = placed_mm(fit.leds_mm[leds], pose)
        per_mm = fit.camera.px_per_mm(at)
        from_origin = at - pose[:2]
        across = np.stack([-from_origin[:, 1], from_origin[:, 0]], axis=1) * math.radians(1.0)
        slopes = np.concatenate([per_mm, (per_mm @ across[:, :, None])], axis=2).reshape(-1, 3)
        of_common = np.zeros((len(leds), 2, len(fit.covariance)))
        parameters = len(fit.camera.parameters)
        of_common[:, :, :parameters] = fit.camera.jacobian(at)
        turned = per_mm @ rotation(pose[2])
        for axis in (0, 1):
            of_common[np.arange(len(leds)), :, parameters + 2 * leds + axis] = turned[:, :, axis]
        common = of_common.reshape(-1, len(fit.covariance))
        weight = np.linalg.inv(scatter_px2 + common @ fit.covariance @ common.T)
        miss = (
            centres_px - fit.camera.to_px(at) - light_centre_shift_px(fit.camera.to_px, at, moment_mm2)
        ).ravel()
        covariance = np.linalg.inv(slopes.T @ weight @ slopes)
        gain = covariance @ slopes.T @ weight
        a, b, phi = (float(x) for x in np.array(pose) + gain @ miss)
        pose = (a, b, wrapped_deg(phi))
    left = miss - slopes @ (gain @ miss)
    chi2, degrees = float(left @ weight @ left), len(miss) - 3
    spread = 2.0 / (9.0 * degrees)
    birge2 = max((chi2 + _PRIOR_DEGREES) / (degrees + _PRIOR_DEGREES), 1.0)
    return SolvedPose(
        pose,
        covariance * birge2,
        gain @ scatter_px2 @ gain.T * birge2,
        (math.cbrt(chi2 / degrees) - 1.0 + spread) / math.sqrt(spread),
    )


def leave_one_out(
    model: Model, leds_mm: FloatArray, views: Sequence[PlateView], disc_mm: float, size: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Measured minus known of each pose by a camera fitted to all others, and its sigma, (n, 3) mm.

    The columns are a, b, and φ at the layout's radius. Sigma includes that of the known pose.
    """
    radius, off, sigma = radius_mm(leds_mm), [], []
    for number, seen in enumerate(views):
        others = [other for at, other in enumerate(views) if at != number]
        fit = fit_plane(model, leds_mm, others, disc_mm, size)
        solved = solve_pose(fit, disc_mm, seen.leds, seen.centres_px, np.zeros(len(seen.leds)))
        a, b, phi = np.array(solved.pose) - seen.pose
        per_unit = np.array([1.0, 1.0, math.radians(1.0) * radius])
        off.append(np.array([a, b, wrapped_deg(float(phi))]) * per_unit)
        sigma.append(np.sqrt(np.diag(solved.covariance) * per_unit**2 + np.square(fit.sigma_pose_mm)))
    return np.array(off), np.array(sigma)
