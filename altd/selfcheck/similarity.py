"""The weighted least-squares similarity of LEDs to their references, with its covariance and its tests."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from altd.records import FloatArray
from altd.selfcheck.records import Similarity, design_rows


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """The similarity, the residuals (n, 2) px of the LEDs, and their weighted square sum with its freedom."""

    similarity: Similarity
    residuals_px: FloatArray
    chi2: float
    degrees_of_freedom: int


def fit_similarity(
    then_px: FloatArray, now_px: FloatArray, sigma_px: FloatArray, about_px: FloatArray, radius_px: float
) -> Fitted:
    """Shift, turn and scale that bring LEDs at ``then_px`` (n, 2) to ``now_px`` (n, 2), n ≥ 2.

    ``sigma_px`` (n,) is the standard deviation of each LED's motion, an axis, reference and check
    together. A similarity is linear in scale·cos and scale·sin. Raises LinAlgError for LEDs that all lie in
    one place.
    """
    right, down = (then_px - about_px).T
    weight = np.repeat(1.0 / sigma_px, 2)
    design = np.zeros((2 * len(then_px), 4))
    design[0::2] = np.column_stack([np.ones_like(right), np.zeros_like(right), right, -down])
    design[1::2] = np.column_stack([np.zeros_like(right), np.ones_like(right), down, right])
    normal = (design * weight[:, None] ** 2).T @ design
    shift_u, shift_v, cos, sin = np.linalg.solve(
        normal, (design * weight[:, None] ** 2).T @ (now_px - about_px).ravel()
    )
    rows = np.concatenate([design_rows(u, v) for u, v in zip(right, down, strict=True)])
    covariance = np.linalg.inv((rows * weight[:, None] ** 2).T @ rows)
    similarity = Similarity(
        about_px=(float(about_px[0]), float(about_px[1])),
        shift_px=(float(shift_u), float(shift_v)),
        turn_deg=math.degrees(math.atan2(sin, cos)),
        scale_ppm=1e6 * (math.hypot(cos, sin) - 1.0),
        covariance=covariance,
        radius_px=radius_px,
    )
    residuals = now_px - similarity.now_px(then_px)
    return Fitted(
        similarity,
        residuals,
        float(np.sum((residuals / sigma_px[:, None]) ** 2)),
        2 * len(then_px) - 4,
    )


def chi2_limit(degrees_of_freedom: int, sigmas: float) -> float:
    """The χ² that chance exceeds as rarely as a Gaussian deviate its ``sigmas`` (Wilson–Hilferty)."""
    if degrees_of_freedom == 0:
        return math.inf
    ninth = 2.0 / (9.0 * degrees_of_freedom)
    return degrees_of_freedom * (1.0 - ninth + sigmas * math.sqrt(ninth)) ** 3
