"""How the beam moves: the motion of the mean spots through the maps and the line through the points."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from altd.config import Installation
from altd.instruments.beam.solver import Beam, joint_jacobian_mm_per_px, line_gain
from altd.records import FloatArray, TargetPoint
from altd.records.motion import Motion, SpotMotion

_ROWS = ("x_mm", "yaw_deg", "y_mm", "pitch_deg")
"""Of the line's gain."""


def beam_motions(
    motion: SpotMotion,
    points: Sequence[TargetPoint],
    z_mm: Sequence[float],
    covariance_mm2: FloatArray,
    beam: Beam,
    installation: Installation,
) -> dict[str, Motion]:
    """The motion of each quantity of ``beam`` that has a sigma, with the signs of its installation.

    ``beam`` is that of the unit frame. yaw = atan(slope), so its derivative is that of the slope over
    1 + slope². Over a few millimetres the maps are taken as straight.
    """
    gain, _ = line_gain(z_mm, covariance_mm2, installation.reference_plane_mm)
    per_slope_deg = [
        math.degrees(math.cos(math.radians(angle)) ** 2) for angle in (beam.yaw_deg, beam.pitch_deg)
    ]
    signs = installation.signs
    scale = np.array([1.0, per_slope_deg[0], 1.0, per_slope_deg[1]]) * [signs[key] for key in _ROWS]
    by_px = scale[:, None] * gain @ joint_jacobian_mm_per_px(points)
    rate, onset = by_px @ motion.rate_px_per_s, by_px @ motion.onset_px_per_s
    rate_variance = _variances(by_px, motion.rate_covariance)
    vibration = np.sqrt(np.maximum(_variances(by_px, motion.vibration_px2), 0.0))
    return {
        key: Motion(
            rate=float(rate[row]),
            sigma_rate=math.sqrt(rate_variance[row]),
            vibration=float(vibration[row]),
            onset=float(onset[row]),
            onset_s=motion.onset_s,
            spread_s2=motion.spread_s2,
        )
        for row, key in enumerate(_ROWS)
    }


def _variances(by_px: FloatArray, covariance_px2: FloatArray) -> FloatArray:
    """Of each row's quantity."""
    variances: FloatArray = np.einsum("ij,jk,ik->i", by_px, covariance_px2, by_px)
    return variances
