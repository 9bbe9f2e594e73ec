"""Least-squares fit of an evenly lit disc that the border of the image may cut."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from altd.records import FloatArray
from altd.vision.image import Image

_MAX_ITERATIONS = 40
_CONVERGED_PX = 1e-4
_DIFFERENCE_STEP = 1e-3
_INITIAL_EDGE_PX, _MIN_EDGE_PX = 2.0, 1.0
_MAX_RELATIVE_RMS = 0.1
_INITIAL_DAMPING = 1e-3


@dataclass(frozen=True, slots=True)
class FittedDisc:
    """Centre and radius in px of the window, level in counts, and the centre's standard deviation an axis."""

    u_px: float
    v_px: float
    radius_px: float
    level: float
    sigma_px: float


def fit_disc(window: Image, initial_radius_px: float) -> FittedDisc | None:
    """Least squares of a disc with a soft edge through a window (h, w) of counts; None where it is no disc.

    Centre, radius, level, what lies under it, and the width of its edge are fitted. It may reach out of the
    window; its centre must lie inside. The standard deviation is that of the residuals, propagated.
    """
    u, v = (places.astype(np.float64) for places in np.meshgrid(*map(np.arange, window.shape[::-1])))
    counts = window.astype(np.float64)
    floor, top = (float(np.percentile(counts, share)) for share in (5.0, 95.0))
    bright = counts > (floor + top) / 2
    if top <= floor or not bright.any():
        return None
    parameters = np.array(
        [u[bright].mean(), v[bright].mean(), initial_radius_px, top - floor, floor, _INITIAL_EDGE_PX]
    )
    residuals = _residuals(parameters, u, v, counts)
    damping = _INITIAL_DAMPING
    for _ in range(_MAX_ITERATIONS):
        jacobian = _jacobian(parameters, u, v, counts)
        normal = jacobian.T @ jacobian
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), -jacobian.T @ residuals)
        candidate = parameters + step
        candidate[5] = max(candidate[5], _MIN_EDGE_PX)
        new_residuals = _residuals(candidate, u, v, counts)
        if new_residuals @ new_residuals < residuals @ residuals:
            parameters, residuals, damping = candidate, new_residuals, damping / 10
            if np.abs(step[:3]).max() < _CONVERGED_PX:
                break
        else:
            damping *= 10
    centre_u, centre_v, radius, level = parameters[:4].tolist()
    rms = math.sqrt(float(residuals @ residuals) / max(len(residuals) - len(parameters), 1))
    inside = 0 <= centre_u < window.shape[1] and 0 <= centre_v < window.shape[0]
    if not inside or radius <= 0 or level <= 0 or rms > _MAX_RELATIVE_RMS * level:
        return None
    jacobian = _jacobian(parameters, u, v, counts)
    normal = jacobian.T @ jacobian
    covariance = rms**2 * np.linalg.pinv(normal)
    sigma_px = math.sqrt(float(covariance[0, 0] + covariance[1, 1]) / 2)
    return FittedDisc(centre_u, centre_v, radius, level, sigma_px)


def _residuals(parameters: FloatArray, u: FloatArray, v: FloatArray, counts: FloatArray) -> FloatArray:
    centre_u, centre_v, radius, level, floor, edge = parameters
    inside = np.clip(0.5 + (radius - np.hypot(u - centre_u, v - centre_v)) / edge, 0.0, 1.0)
    share = inside * inside * (3.0 - 2.0 * inside)  # a blurred edge has no corners
    residuals: FloatArray = (floor + level * share - counts).ravel()
    return residuals


def _jacobian(parameters: FloatArray, u: FloatArray, v: FloatArray, counts: FloatArray) -> FloatArray:
    """Derivatives (n, 6) of the residuals by the parameters, by central differences."""
    columns = []
    for index in range(len(parameters)):
        step = np.zeros(len(parameters))
        step[index] = _DIFFERENCE_STEP
        columns.append(
            (_residuals(parameters + step, u, v, counts) - _residuals(parameters - step, u, v, counts))
            / (2 * _DIFFERENCE_STEP)
        )
    return np.stack(columns, axis=1)
