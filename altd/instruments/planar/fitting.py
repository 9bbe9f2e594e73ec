"""Fit of a camera to known poses of the plate, with all uncertainties."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from altd.instruments.planar.homography import fit_rims, vanishing_line_homography
from altd.instruments.planar.layout import Pose, placed_mm, rotation
from altd.instruments.planar.plane import Model, PlaneCamera, homography_camera, lens_camera
from altd.mapping.camera_model import light_centre_shift_px
from altd.records import FloatArray

MIN_POSES_FOR_SPREAD = 3
"""Minimum number of known poses to separate errors of poses, of LED positions and of centres."""

_ITERATIONS = 12
_MAX_HALVINGS = 10
"""Maximum number of halvings of a step that makes the fit worse."""
_MIN_NOISE_PX = 1e-3
_MIN_SIGMA_MM = 1e-4
_INITIAL_NOISE_PX = 0.02
_INITIAL_SIGMA_MM = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class PlateView:
    """The plate at a known pose: LEDs (n,), centres (n, 2) px of their discs, and points of their rims."""

    pose: Pose
    leds: npt.NDArray[np.intp]
    centres_px: FloatArray
    rims_px: tuple[FloatArray, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A fitted camera with the fitted positions of the plate's LEDs.

    ``covariance`` covers the camera's parameters and then x, y of each LED. ``noise_px`` is the standard
    deviation of a centre that averaging does not reduce, ``sigma_led_mm`` that of an LED from its stated
    position, ``sigma_pose_mm`` (3,) those of a known pose: of a, of b, and of φ at the layout's radius.
    """

    camera: PlaneCamera
    leds_mm: FloatArray
    covariance: FloatArray
    noise_px: float
    sigma_led_mm: float
    sigma_pose_mm: tuple[float, float, float]


def fit_plane(
    model: Model, leds_mm: FloatArray, views: Sequence[PlateView], disc_mm: float, size: tuple[int, int]
) -> PlaneFit:
    """Fit the camera of a model, and the errors of LEDs and poses that explain its residuals.

    The homography is fitted as in the source: by the vanishing line, then by Gauss–Newton over the discs'
    rims. The lens is fitted to the discs' centres, its parameters together with the errors of LEDs and poses.
    These are zero-mean normal deviates whose variances make the observations most probable (the fixed point
    of MacKay, "Bayesian interpolation", 1992). Raises ValueError when there are too few LEDs.
    """
    seen_mm = np.concatenate([placed_mm(leds_mm[of.leds], of.pose) for of in views])
    seen_px = np.concatenate([of.centres_px for of in views])
    if model == "homography":
        rims = [rim for of in views for rim in of.rims_px]
        h = fit_rims(vanishing_line_homography(seen_px, seen_mm), rims, seen_mm, disc_mm / 2)
        camera = homography_camera(h, seen_mm, size)
    else:
        camera = lens_camera(seen_mm, seen_px, size)
    return _with_spread(camera, leds_mm, views, disc_mm**2 / 16, is_free=model == "lens")


def radius_mm(leds_mm: FloatArray) -> float:
    """Radius of the layout, mm, to state a turn as a length: rms distance from the plate's origin."""
    return float(np.sqrt(np.mean(np.sum(leds_mm**2, axis=1))))


def _with_spread(
    camera: PlaneCamera,
    leds_mm: FloatArray,
    views: Sequence[PlateView],
    moment_mm2: float,
    is_free: bool,
) -> PlaneFit:
    """Fit of ``fit_plane``; a camera that is not free keeps its parameters and gets its covariance."""
    design = _Design(leds_mm, views, moment_mm2)
    cameras, leds = (
        len(camera.parameters),
        slice(len(camera.parameters), len(camera.parameters) + leds_mm.size),
    )
    poses = slice(leds.stop, leds.stop + 3 * len(views))
    can_tell = len(views) >= MIN_POSES_FOR_SPREAD
    noise, sigma_led = _INITIAL_NOISE_PX, _INITIAL_SIGMA_MM if can_tell else _MIN_SIGMA_MM
    sigma_pose = np.full(3, sigma_led)
    errors = np.zeros(poses.stop - cameras)
    jacobian, miss = design.linearised(camera, errors)
    for _ in range(_ITERATIONS):
        precision = np.concatenate(
            [
                camera.precision,
                np.full(leds_mm.size, sigma_led**-2),
                np.tile(sigma_pose**-2, len(views)),
            ]
        )
        known = np.concatenate([camera.parameters, errors])
        free = slice(0 if is_free else cameras, None)
        normal = jacobian.T @ jacobian / noise**2 + np.diag(precision)
        step = np.zeros(len(known))
        step[free] = np.linalg.solve(
            normal[free, free], (jacobian.T @ miss / noise**2 - known * precision)[free]
        )
        cost = float(miss @ miss) / noise**2 + float(known**2 @ precision)
        for _ in range(_MAX_HALVINGS):
            moved = camera.moved_by(step[:cameras]), errors + step[cameras:]
            with np.errstate(all="ignore"):  # for a step that is too large
                of_moved = design.linearised(*moved)
                penalty = float((known + step) ** 2 @ precision)
                if float(of_moved[1] @ of_moved[1]) / noise**2 + penalty <= cost:
                    (camera, errors), (jacobian, miss) = moved, of_moved
                    break
            step /= 2
        covariance = np.linalg.inv(normal)
        of_data = 1.0 - np.diag(covariance) * precision
        degrees = max(len(miss) - float(of_data.sum()), 1.0)
        noise = max(math.sqrt(float(miss @ miss) / degrees), _MIN_NOISE_PX)
        if can_tell:
            sigma_led = _sigma(errors[: leds_mm.size], of_data[leds])
            of_poses, known_of = errors[leds_mm.size :].reshape(-1, 3), of_data[poses].reshape(-1, 3)
            place = _sigma(of_poses[:, :2].ravel(), known_of[:, :2].ravel())
            sigma_pose = np.array([place, place, _sigma(of_poses[:, 2], known_of[:, 2])])
    return PlaneFit(
        camera,
        leds_mm + errors[: leds_mm.size].reshape(-1, 2),
        np.asarray(covariance[: leds.stop, : leds.stop], dtype=np.float64),
        noise,
        sigma_led,
        (float(sigma_pose[0]), float(sigma_pose[1]), float(sigma_pose[2])),
    )


def _sigma(errors: FloatArray, of_data: FloatArray) -> float:
    """Standard deviation of errors, each weighted by how far the observations determine it."""
    return max(math.sqrt(float(errors @ errors) / max(float(of_data.sum()), 1e-9)), _MIN_SIGMA_MM)


class _Design:
    """Centres of all discs as functions of camera, LEDs and poses."""

    def __init__(self, leds_mm: FloatArray, views: Sequence[PlateView], moment_mm2: float) -> None:
        self._leds_mm, self._views, self._moment_mm2 = leds_mm, views, moment_mm2
        self._seen_px = np.concatenate([of.centres_px for of in views])
        self._radius_mm = radius_mm(leds_mm)

    def linearised(self, camera: PlaneCamera, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """d(px)/d(parameters, LEDs, poses) and observed minus computed px, one row each for u and v."""
        leds = self._leds_mm + errors[: self._leds_mm.size].reshape(-1, 2)
        of_poses = errors[self._leds_mm.size :].reshape(-1, 3)
        points, slopes = [], []
        for number, (seen, error) in enumerate(zip(self._views, of_poses, strict=True)):
            phi_deg = seen.pose[2] + math.degrees(error[2] / self._radius_mm)
            turned = leds[seen.leds] @ rotation(phi_deg).T
            points.append(turned + seen.pose[:2] + error[:2])
            slope = np.zeros((len(turned), 2, len(errors)))
            each = np.arange(len(turned))
            for axis in (0, 1):
                slope[each, :, 2 * seen.leds + axis] = rotation(phi_deg)[:, axis]
                slope[:, axis, leds.size + 3 * number + axis] = 1.0
            across = np.stack([-turned[:, 1], turned[:, 0]], axis=1)
            slope[:, :, leds.size + 3 * number + 2] = across / self._radius_mm
            slopes.append(slope)
        at = np.concatenate(points)
        of_places = camera.px_per_mm(at) @ np.concatenate(slopes)
        jacobian = np.concatenate([camera.jacobian(at), of_places], axis=2)
        shift = light_centre_shift_px(camera.to_px, at, self._moment_mm2)
        miss: FloatArray = self._seen_px - camera.to_px(at) - shift
        return jacobian.reshape(2 * len(at), -1), miss.ravel()


def scaled(fit: PlaneFit, factor: float) -> PlaneFit:
    """Copy of a fit with covariance and noise scaled by ``factor`` in sigma."""
    return replace(fit, covariance=fit.covariance * factor**2, noise_px=fit.noise_px * factor)
