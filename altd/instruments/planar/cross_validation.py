"""Leave-one-out errors of a model at known poses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from altd.instruments.planar.fitting import PlateView, fit_plane, radius_mm
from altd.instruments.planar.layout import wrapped_deg
from altd.instruments.planar.plane import Model
from altd.instruments.planar.pose import solve_pose
from altd.records import FloatArray


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
