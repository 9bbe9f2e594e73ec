"""An evenly lit disc of which the border of the picture may cut a part, fitted on what is there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from altd.records import FloatArray
from altd.vision.background import Image

_MAX_STEPS = 40
_CONVERGED_PX = 1e-4
_DIFFERENCE = 1e-3
_FIRST_EDGE_PX, _MIN_EDGE_PX = 2.0, 1.0
_MAX_MISFIT = 0.1
_FIRST_DAMPING = 1e-3


@dataclass(frozen=True, slots=True)
class FittedDisc:
    """Centre and radius in px of the window, level in counts, and the centre's standard deviation an axis."""

    u_px: float
    v_px: float
    radius_px: float
    level: float
    sigma_px: float


def fit_disc(window: Image, first_radius_px: float) -> FittedDisc | None:
    """Least squares of a disc with a soft edge through a window (h, w) of counts; None where it is no disc.

    Centre, radius, level, what lies under it, and the width of its edge are fitted. It may reach out of the
    window; its centre must lie inside. The standard deviation is what the misfit leaves uncertain.
    """
    u, v = (places.astype(np.float64) for places in np.meshgrid(*map(np.arange, window.shape[::-1])))
    counts = window.astype(np.float64)
    floor, top = (float(np.percentile(counts, share)) for share in (5.0, 95.0))
    bright = counts > (floor + top) / 2
    if top <= floor or not bright.any():
        return None
    at = np.array([u[bright].mean(), v[bright].mean(), first_radius_px, top - floor, floor, _FIRST_EDGE_PX])
    misfit = _misfit(at, u, v, counts)
    damping = _FIRST_DAMPING
    for _ in range(_MAX_STEPS):
        slopes = _slopes(at, u, v, counts)
        normal = slopes.T @ slopes
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), -slopes.T @ misfit)
        candidate = at + step
        candidate[5] = max(candidate[5], _MIN_EDGE_PX)
        then = _misfit(candidate, u, v, counts)
        if then @ then < misfit @ misfit:
            at, misfit, damping = candidate, then, damping / 10
            if np.abs(step[:3]).max() < _CONVERGED_PX:
                break
        else:
            damping *= 10
    centre_u, centre_v, radius, level = at[:4].tolist()
    rms = math.sqrt(float(misfit @ misfit) / max(len(misfit) - len(at), 1))
    inside = 0 <= centre_u < window.shape[1] and 0 <= centre_v < window.shape[0]
    if not inside or radius <= 0 or level <= 0 or rms > _MAX_MISFIT * level:
        return None
    slopes = _slopes(at, u, v, counts)
    normal = slopes.T @ slopes
    covariance = rms**2 * np.linalg.pinv(normal)
    sigma_px = math.sqrt(float(covariance[0, 0] + covariance[1, 1]) / 2)
    return FittedDisc(centre_u, centre_v, radius, level, sigma_px)


def _misfit(at: FloatArray, u: FloatArray, v: FloatArray, counts: FloatArray) -> FloatArray:
    centre_u, centre_v, radius, level, floor, edge = at
    inside = np.clip(0.5 + (radius - np.hypot(u - centre_u, v - centre_v)) / edge, 0.0, 1.0)
    share = inside * inside * (3.0 - 2.0 * inside)  # a blurred edge has no corners
    misfit: FloatArray = (floor + level * share - counts).ravel()
    return misfit


def _slopes(at: FloatArray, u: FloatArray, v: FloatArray, counts: FloatArray) -> FloatArray:
    """Slopes (n, 6) of the misfit, by central differences."""
    columns = []
    for index in range(len(at)):
        step = np.zeros(len(at))
        step[index] = _DIFFERENCE
        columns.append(
            (_misfit(at + step, u, v, counts) - _misfit(at - step, u, v, counts)) / (2 * _DIFFERENCE)
        )
    return np.stack(columns, axis=1)
