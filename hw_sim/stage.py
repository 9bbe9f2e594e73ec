"""The calibration table: it positions a beam in front of the targets, with typical errors."""

from dataclasses import dataclass

import numpy as np

from hw_sim.beam import BeamPose

STAGE_SIGMA_MM = 0.002
"""Positioning error per axis, well within the 6 µm steps of App. A.3."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """Errors that a scan shares with its own reference, each (x, y), and the mounting of the unit.

    The table moves by 1 + ``scale_ppm`` of the reported position, its axes move x by ``square_mrad`` of y and
    vice versa, and its beam has slopes ``tilt_mm_per_m``. ``is_turned``: the unit is turned by half a turn
    about its own z axis, and its middle is then at ``seat_mm`` of the table.
    """

    scale_ppm: tuple[float, float] = (0.0, 0.0)
    square_mrad: tuple[float, float] = (0.0, 0.0)
    tilt_mm_per_m: tuple[float, float] = (0.0, 0.0)
    is_turned: bool = False
    seat_mm: tuple[float, float] = (0.4, -0.3)


ADJUSTED = Mounting()
MISALIGNED = Mounting((120.0, 120.0), (0.2, 0.0), (-0.8, 0.47))
"""Typical errors of a table and a beam for a metrologist without a separate reference."""


class Stage:
    """An xy-table with a stated positioning error (1 sigma per axis, mm)."""

    def __init__(
        self, rng: np.random.Generator, sigma_mm: float = STAGE_SIGMA_MM, mounting: Mounting = ADJUSTED
    ) -> None:
        self._rng = rng
        self.sigma_mm = sigma_mm
        self.mounting = mounting

    def place(self, x_mm: float, y_mm: float) -> BeamPose:
        """True beam in the unit frame when the table reports (x, y)."""
        of = self.mounting
        error_x, error_y = self._rng.normal(0.0, self.sigma_mm, size=2)
        table_x = x_mm * (1 + of.scale_ppm[0] * 1e-6) + of.square_mrad[0] * 1e-3 * y_mm + float(error_x)
        table_y = y_mm * (1 + of.scale_ppm[1] * 1e-6) + of.square_mrad[1] * 1e-3 * x_mm + float(error_y)
        slope_x, slope_y = (slope * 1e-3 for slope in of.tilt_mm_per_m)
        if of.is_turned:
            return BeamPose(of.seat_mm[0] - table_x, of.seat_mm[1] - table_y, -slope_x, -slope_y)
        return BeamPose(table_x, table_y, slope_x, slope_y)

    def header(self) -> dict[str, object]:
        """Keys of a scan's header: the errors in the table's certificate, 1 sigma for each axis."""
        of = self.mounting
        limits = {
            "stage_mm": self.sigma_mm,
            "stage_scale_ppm": max(map(abs, of.scale_ppm)),
            "stage_square_mrad": max(map(abs, of.square_mrad)),
            "beam_normal_mm_per_m": max(map(abs, of.tilt_mm_per_m)),
            "target_distance_mm": 0.0,
            "temperature_k": 0.0,
        }
        return {"limits": limits} | ({"turned_deg": 180} if of.is_turned else {})
