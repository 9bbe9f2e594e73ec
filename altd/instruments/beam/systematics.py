"""Effects on the points of a beam that its scatter does not show (docs/budget.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from altd.config import Expansion
from altd.records import FloatArray, Limits

_OPERATION_C = (-10.0, 60.0)
"""Specified temperatures of operation (App. A.1)."""
_THERMOMETER_K = 1.0
"""Standard uncertainty of the difference of two temperatures of the frame: its parts are not equally warm."""
_TO_MM = {
    "stage_scale_ppm": 1e-6,
    "stage_square_mrad": 1e-3,
    "beam_normal_mm_per_m": 1e-3,
    "plate_mm": 1.0,
    "plate_turn_mrad": 1e-3,
    "plate_keystone_per_m": 1e-3,
}
"""Factors from the unit of each limit to a dimensionless number, of a keystone to 1/mm."""
_HIGHEST_HZ = 130.0
"""Highest frequency of a vibration; an exposure of some ms averages over higher ones."""


@dataclass(frozen=True, slots=True)
class Warmth:
    """Temperature of the frame above that of its calibration, its uncertainty (1 sigma), and the expansion.

    A frame that is warmer moves the cameras from their targets, so each pixel sees a larger part of the
    target, about the zero of the unit frame, and moves the targets from each other.
    """

    by_k: float = 0.0
    sigma_k: float = 0.0
    expansion: Expansion = field(default_factory=Expansion)

    @classmethod
    def measured(
        cls, now_c: float | None, calibrated_c: float, stated_k: float | None, expansion: Expansion
    ) -> Self:
        """Warmth by a thermometer on the frame.

        Without a reading sigma has what was stated, or else all temperatures of operation. A reading beyond
        these is in sigma, too, and nothing is corrected by it: a broken sensor may read 85 °C.
        """
        low_c, high_c = _OPERATION_C
        if now_c is None:
            any_k = math.hypot((low_c + high_c) / 2 - calibrated_c, (high_c - low_c) / math.sqrt(12.0))
            return cls(0.0, any_k if stated_k is None else stated_k, expansion)
        if low_c <= now_c <= high_c:
            return cls(now_c - calibrated_c, _THERMOMETER_K, expansion)
        return cls(0.0, math.hypot(now_c - calibrated_c, _THERMOMETER_K), expansion)

    @property
    def distance_growth(self) -> float:
        """Growth of the distances between the targets, a factor."""
        return 1.0 + 1e-6 * float(self.expansion.distance_ppm_per_k) * self.by_k

    @property
    def view_growth(self) -> float:
        """Growth of the places on the targets that the pixels see, a factor."""
        return 1.0 + 1e-6 * float(self.expansion.view_ppm_per_k) * self.by_k

    def effects_mm(self, points_mm: FloatArray, lever_mm: FloatArray) -> FloatArray:
        """Displacements (2 T, 3) by one sigma: of each expansion, and of the temperature, which is in both.

        ``points_mm`` (2 T,) are the points, ``lever_mm`` (2 T,) the slopes times z.
        """
        of, warm_k = self.expansion, math.hypot(self.by_k, self.sigma_k)
        both = self.sigma_k * (of.view_ppm_per_k * points_mm - of.distance_ppm_per_k * lever_mm)
        view, distance = of.view_sigma_ppm_per_k * warm_k, of.distance_sigma_ppm_per_k * warm_k
        return 1e-6 * np.column_stack([view * points_mm, distance * lever_mm, both])


def effects_mm(
    limits: Limits,
    z_mm: Sequence[float],
    points_mm: FloatArray,
    slopes: tuple[float, float],
    warmth: Warmth | None = None,
) -> dict[str, FloatArray]:
    """Displacements (2 T, n) of the points, mm, by one sigma of each limit that is not 0, by key.

    ``stage_mm`` is not among them: it is part of the maps' covariance. A column is one independent error, x
    and y of one target after the other. ``points_mm`` (T, 2) are the points of a beam with these slopes. A
    stage whose scale is long by s puts the beam at (1 + s) times the stated position on every target. Axes
    out of square by q move x by q · y. A beam tilted from the normal by t meets the target at z with an error
    of t · z. A target farther away by d is met d · slope further along. These errors have one column for x
    and one for y; the distance has one column per target after the first. ``warmth`` replaces the
    limit ``temperature_k``. Errors of the plates are independent from target to target: a plate turned
    about z, or tilted by a, which a camera at the distance A sees at (1 + (a / A) · place) times its
    place.
    """
    z, x, y = np.asarray(z_mm, dtype=np.float64), points_mm[:, 0], points_mm[:, 1]
    effects = {}
    for key, along_x, along_y in (
        ("stage_scale_ppm", x, y),
        ("stage_square_mrad", y, x),
        ("beam_normal_mm_per_m", z, z),
        ("plate_mm", np.ones_like(z), np.ones_like(z)),
    ):
        if sigma := getattr(limits, key):
            columns = np.zeros((2 * len(z), 2))
            columns[0::2, 0], columns[1::2, 1] = along_x, along_y
            effects[key] = sigma * _TO_MM[key] * columns
    for key, blocks in (
        ("plate_turn_mrad", np.stack([-y, x], axis=1)[:, :, None]),
        ("plate_keystone_per_m", np.einsum("ti,tj->tij", points_mm, points_mm)),
    ):
        if sigma := getattr(limits, key):
            apart = np.einsum("tij,tu->tiuj", blocks, np.eye(len(z)))  # of one target after the other
            effects[key] = sigma * _TO_MM[key] * apart.reshape(2 * len(z), -1)
    if sigma := limits.target_distance_mm:
        columns = np.zeros((2 * len(z), len(z) - 1))
        for farther in range(1, len(z)):
            columns[2 * farther : 2 * farther + 2, farther - 1] = slopes
        effects["target_distance_mm"] = sigma * columns
    if warmth is None and limits.temperature_k:
        warmth = Warmth(sigma_k=limits.temperature_k)
    if warmth is not None:
        effects["temperature_k"] = warmth.effects_mm(points_mm.ravel(), np.outer(z, slopes).ravel())
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
