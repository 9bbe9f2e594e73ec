"""The distance between the centre of a patch of light, in the picture, and the picture of its centre.

An even disc of radius R about c is seen through a smooth map P (mm → px) with the Jacobian J. Its picture is
evenly bright, so its centre of area is ∫ P |J| dA / ∫ |J| dA. With P(c + d) = P + J d + ½ dᵀ P″ d + …,
|J(c + d)| = |J| (1 + g·d + …), g = ∇ ln |J|, and the disc's second moment ⟨d dᵀ⟩ = m I, m = R²/4, the terms
of second order are

    centre − P(c) = m (½ ∇²P + J g) + O(R⁴).

For a pinhole that is the known bias of a circle's centre under perspective (J. Heikkilä, O. Silvén, "A
four-step camera calibration procedure with implicit image correction", CVPR 1997); written with the map's own
derivatives it holds for any lens. A round laser spot is shifted alike, with the second moment of the weights
that its localiser uses.
"""

from __future__ import annotations

import numpy as np

from altd.mapping.camera_model import ToPx, jacobian_px_per_mm
from altd.records import FloatArray

_DELTA_MM = 0.5
"""The step of all derivatives: second ones need one so long, and first ones use it too."""


def px2_per_mm2(to_px: ToPx, points_mm: FloatArray) -> FloatArray:
    """By how much a map enlarges areas at points (n, 2), (n,)."""
    return np.asarray(np.abs(np.linalg.det(jacobian_px_per_mm(to_px, points_mm, _DELTA_MM))))


def light_centre_shift_px(to_px: ToPx, points_mm: FloatArray, moment_mm2: float) -> FloatArray:
    """The shift, (n, 2) px, of the centre of light of patches about points (n, 2) mm: centre − P(c)."""
    here = to_px(points_mm)
    laplacian = np.zeros_like(here)
    log_gradient = np.zeros_like(here)
    for axis, step in enumerate(_DELTA_MM * np.eye(2)):
        ahead, behind = points_mm + step, points_mm - step
        laplacian += (to_px(ahead) + to_px(behind) - 2 * here) / _DELTA_MM**2
        log_gradient[:, axis] = (_log_area(to_px, ahead) - _log_area(to_px, behind)) / (2 * _DELTA_MM)
    tilt = np.einsum("nij,nj->ni", jacobian_px_per_mm(to_px, points_mm, _DELTA_MM), log_gradient)
    return np.asarray(moment_mm2 * (laplacian / 2 + tilt))


def disc_moment_mm2(diameter_mm: float) -> float:
    """Second moment along one axis of an even disc."""
    return diameter_mm**2 / 16


def spot_moment_mm2(diameter_mm: float, threshold: float, power: float) -> float:
    """Second moment along one axis of the weights (I − T)₊^p of a Gaussian spot of that 1/e² diameter.

    With s = r², I = exp(−8 s/D²), the moment is ½ ∫ s w ds / ∫ w ds, by the midpoint rule.
    """
    steps = 2000
    s = (np.arange(steps) + 0.5) / steps * np.log(1 / max(threshold, 1e-3))  # in units of D²/8
    weight = np.maximum(np.exp(-s) - threshold, 0) ** power
    return float(diameter_mm**2 / 16 * (s @ weight) / weight.sum())


def _log_area(to_px: ToPx, points_mm: FloatArray) -> FloatArray:
    return np.asarray(np.log(px2_per_mm2(to_px, points_mm)))
