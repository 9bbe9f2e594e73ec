"""The calibration table: positions a beam normal to the targets, with an error."""

from __future__ import annotations

import numpy as np

from hw_sim.beam import BeamPose

STAGE_SIGMA_MM = 0.002
"""Positioning error per axis, well within the 6 µm steps of App. A.3."""


class Stage:
    """An xy-table with a stated positioning error (1 sigma per axis, mm)."""

    def __init__(self, rng: np.random.Generator, sigma_mm: float = STAGE_SIGMA_MM) -> None:
        self._rng = rng
        self._sigma_mm = sigma_mm

    def place(self, x_mm: float, y_mm: float) -> BeamPose:
        """The true beam when the table reports (x, y)."""
        error_x, error_y = self._rng.normal(0.0, self._sigma_mm, size=2)
        return BeamPose(x_mm + float(error_x), y_mm + float(error_y))
