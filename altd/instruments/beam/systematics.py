"""Effects on the points of a beam that its scatter does not show (docs/budget.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from altd.records import FloatArray, Limits

_TO_MM = {"stage_scale_ppm": 1e-6, "stage_square_mrad": 1e-3, "beam_normal_mm_per_m": 1e-3}
"""Factors from the unit of each limit to a dimensionless number."""
ALUMINIUM_PER_K = 23.6e-6
"""Linear expansion of aluminium 6061 (Callister, Materials Science and Engineering, Table B.6)."""
_HIGHEST_HZ = 130.0
"""Highest frequency of a vibration; an exposure of some ms averages over higher ones."""


def effects_mm(
    limits: Limits, z_mm: Sequence[float], points_mm: FloatArray, slopes: tuple[float, float]
) -> dict[str, FloatArray]:
    """Displacements (2 T, n) of the points, mm, by one sigma of each limit that is not 0, by key.

    ``stage_mm`` is not among them: it is part of the maps' covariance. A column is one independent error, x
    and y of one target after the other. ``points_mm`` (T, 2) are the points of a beam with these slopes. A
    stage whose scale is long by s puts the beam at (1 + s) times the stated position on every target. Axes
    out of square by q move x by q · y. A beam tilted from the normal by t meets the target at z with an error
    of t · z. A target farther away by d is met d · slope further along. These errors have one column for x
    and one for y; the distance has one column per target after the first. A frame that is warmer moves the
    cameras from their targets, which shrinks all pictures about the zero of the unit frame (first column),
    and the targets from each other (second column).
    """
    z, x, y = np.asarray(z_mm, dtype=np.float64), points_mm[:, 0], points_mm[:, 1]
    effects = {}
    for key, along_x, along_y in (
        ("stage_scale_ppm", x, y),
        ("stage_square_mrad", y, x),
        ("beam_normal_mm_per_m", z, z),
    ):
        if sigma := getattr(limits, key):
            columns = np.zeros((2 * len(z), 2))
            columns[0::2, 0], columns[1::2, 1] = along_x, along_y
            effects[key] = sigma * _TO_MM[key] * columns
    if sigma := limits.target_distance_mm:
        columns = np.zeros((2 * len(z), len(z) - 1))
        for farther in range(1, len(z)):
            columns[2 * farther : 2 * farther + 2, farther - 1] = slopes
        effects["target_distance_mm"] = sigma * columns
    if sigma := limits.temperature_k:
        columns = np.column_stack([points_mm.ravel(), np.outer(z, slopes).ravel()])
        effects["temperature_k"] = sigma * ALUMINIUM_PER_K * columns
    return effects


def vibration_mm(
    z_mm: Sequence[float], amplitude_mm: float, amplitude_mrad: float, apart_s: float = 0.0
) -> FloatArray:
    """Displacements (2 T, 6) of the points, mm, by one sigma of a vibration with these amplitudes.

    A sinusoid of unknown phase has a standard deviation of amplitude/√2. Two columns each for x and y, since
    targets that are exposed ``apart_s`` from each other are displaced by different phases, up to opposite
    ones; one each for yaw and pitch. The unit turns about the plane z = 0.
    """
    z = np.asarray(z_mm, dtype=np.float64)
    half = min(math.pi * _HIGHEST_HZ * apart_s, math.pi / 2)
    together, opposite = np.array((math.cos(half), math.sin(half))) * amplitude_mm / math.sqrt(2.0)
    columns = np.zeros((2 * len(z), 6))
    columns[0::2, 0] = columns[1::2, 1] = together
    columns[0::2, 4] = columns[1::2, 5] = opposite * np.linspace(1.0, -1.0, len(z))
    columns[0::2, 2] = columns[1::2, 3] = amplitude_mrad * 1e-3 * z / math.sqrt(2.0)
    return columns
