"""Refraction in the glass behind a target: the beam leaves it parallel to itself, but displaced.

Snell's law: sin θ = n sin θ', where θ is the angle to the targets' common normal, tan θ = |s| for the slopes
s = (sx, sy). In glass of thickness t the beam moves sideways by t tan θ' instead of t tan θ (Hecht, Optics,
4.4; Born and Wolf, Principles of Optics, 1.5.1). Behind it the beam is displaced by −d,

    d = t (tan θ − tan θ') s/|s| = t s (1 − 1/w),  w² = n² + (n² − 1) |s|².

Measured perpendicular to the beam, this is the textbooks' t sin θ (1 − cos θ/√(n² − sin² θ)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from altd.measuring.calibration import Calibration
from altd.records import FloatArray, Glass

SIGMAS = {"glass_mm": 0.1, "glass_index": 0.01}
"""Standard uncertainties of a stated pane: half the tolerance of thin float glass (EN 572-2, ± 0.2 mm), and
the variation of the index between kinds of glass and wavelengths."""


def displacement_mm(slopes: FloatArray, glass: Glass) -> tuple[FloatArray, FloatArray]:
    """Displacement d (2,) of a beam with the slopes (sx, sy), mm, and its derivatives by them (2, 2)."""
    w = _w(slopes, glass)
    per_slope = (1 - 1 / w) * np.eye(2) + (glass.index**2 - 1) / w**3 * np.outer(slopes, slopes)
    return glass.thickness_mm * (1 - 1 / w) * slopes, glass.thickness_mm * per_slope


def displacement_sensitivities(slopes: FloatArray, glass: Glass) -> tuple[FloatArray, FloatArray]:
    """Derivatives of d by the thickness, mm/mm, and by the refractive index, mm, (2,) each."""
    w = _w(slopes, glass)
    per_index = glass.thickness_mm * glass.index * (1 + slopes @ slopes) / w**3
    return (1 - 1 / w) * slopes, per_index * slopes


def _w(slopes: FloatArray, glass: Glass) -> float:
    return math.sqrt(glass.index**2 + (glass.index**2 - 1) * float(slopes @ slopes))


@dataclass(frozen=True)
class Refraction:
    """Glass of a unit: each pane with the position z of the target in front of it.

    A pane displaces the beam at all targets behind it. In a calibration scan the beam meets the glass at
    normal incidence, so the maps need no correction: a laser tilted by 0.8 mm/m is displaced by 1 µm in 4 mm.
    """

    panes: tuple[tuple[float, Glass], ...]

    @classmethod
    def from_calibration(cls, calibration: Calibration) -> Self | None:
        """Glass of a unit as stated by its calibration; None where there is none."""
        panes = tuple(
            (target.z_mm, target.glass)
            for target in calibration.targets
            if target.glass and target.glass.thickness_mm
        )
        return cls(panes) if panes else None

    def grown(self, factor: float) -> Self:
        """Glass of a unit whose targets are ``factor`` times as far apart."""
        return replace(self, panes=tuple((factor * pane_mm, glass) for pane_mm, glass in self.panes))

    def displaced_mm(self, slopes: FloatArray, z_mm: Sequence[float]) -> tuple[FloatArray, FloatArray]:
        """Sum of d at each of T targets (2 T,), mm, and its derivatives by the slopes (2 T, 2)."""
        displaced, per_slope = np.zeros(2 * len(z_mm)), np.zeros((2 * len(z_mm), 2))
        for pane_mm, glass in self.panes:
            behind = np.repeat(np.asarray(z_mm) > pane_mm, 2)
            d, of_slope = displacement_mm(slopes, glass)
            displaced += behind * np.tile(d, len(z_mm))
            per_slope += behind[:, None] * np.tile(of_slope, (len(z_mm), 1))
        return displaced, per_slope

    def effects_mm(self, slopes: FloatArray, z_mm: Sequence[float]) -> dict[str, FloatArray]:
        """Displacements (2 T, panes) of the points, mm, by one sigma of thickness and of index, by key."""
        columns: dict[str, list[FloatArray]] = {key: [] for key in SIGMAS}
        for pane_mm, glass in self.panes:
            behind = np.repeat(np.asarray(z_mm) > pane_mm, 2)
            for (key, sigma), of_one in zip(
                SIGMAS.items(), displacement_sensitivities(slopes, glass), strict=True
            ):
                columns[key].append(np.where(behind, sigma * np.tile(of_one, len(z_mm)), 0.0))
        return {key: np.column_stack(of_panes) for key, of_panes in columns.items()}
