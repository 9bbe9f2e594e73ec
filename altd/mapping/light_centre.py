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

from altd.mapping.camera_model import ToPx, jacobian_px_per_mm, to_px_about
from altd.records import FloatArray

_DELTA_MM = 0.5
"""The step of all derivatives: second ones need one so long, and first ones use it too."""
_STEPS = np.arange(-2.0, 3.0)


def px2_per_mm2(to_px: ToPx, points_mm: FloatArray) -> FloatArray:
    """By how much a map enlarges areas at points (n, 2), (n,)."""
    return np.asarray(np.abs(np.linalg.det(jacobian_px_per_mm(to_px, points_mm, _DELTA_MM))))


def light_centre_shift_px(to_px: ToPx, points_mm: FloatArray, moment_mm2: float) -> FloatArray:
    """The shift, (n, 2) px, of the centre of light of patches about points (n, 2) mm: centre − P(c)."""
    # [i, j]: the map (n, 2) at i, j steps along x, y
    grid = np.stack(np.meshgrid(_STEPS, _STEPS, indexing="ij"), axis=-1).reshape(-1, 2)
    px = to_px_about(to_px, points_mm, _DELTA_MM * grid).reshape(5, 5, -1, 2)
    slopes = np.stack([px[2:, 1:-1] - px[:-2, 1:-1], px[1:-1, 2:] - px[1:-1, :-2]], axis=-1) / (2 * _DELTA_MM)
    log_area = np.log(np.abs(np.linalg.det(slopes)))  # [i, j], one step to either side
    laplacian = (px[3, 2] + px[1, 2] + px[2, 3] + px[2, 1] - 4 * px[2, 2]) / _DELTA_MM**2
    log_gradient = np.stack([log_area[2, 1] - log_area[0, 1], log_area[1, 2] - log_area[1, 0]], axis=-1)
    tilt = np.einsum("nij,nj->ni", slopes[1, 1], log_gradient / (2 * _DELTA_MM))
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
