"""The reference beam: where it runs in the unit frame, and the irradiance it puts on a target."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hw_sim.dust import Shadow

TAIL_CUTOFF = 1e-6
"""Below this share of the peak the beam is not rendered: 0.02 counts of 16 bits."""


@dataclass(frozen=True, slots=True)
class BeamPose:
    """A beam that enters at (x, y) mm on z = 0 and runs with dimensionless slopes (dx/dz, dy/dz)."""

    x_mm: float
    y_mm: float
    slope_x: float = 0.0
    slope_y: float = 0.0

    @property
    def yaw_deg(self) -> float:
        """The angle in the plane of x and z."""
        return math.degrees(math.atan(self.slope_x))

    @property
    def pitch_deg(self) -> float:
        """The angle in the plane of y and z."""
        return math.degrees(math.atan(self.slope_y))

    def at(self, z_mm: float) -> tuple[float, float]:
        """The intersection of the beam with the plane at ``z_mm``, (x, y) in mm."""
        return self.x_mm + self.slope_x * z_mm, self.y_mm + self.slope_y * z_mm


@dataclass(frozen=True, slots=True)
class Laser:
    """The reference laser (App. A.1: 1–5 mW, ellipse or circle up to 15 mm).

    The profile across the beam is exp(−2 ρ^(2·order)), ρ = 1 on the ellipse of the 1/e² diameters, whose
    first axis is turned by ``angle_rad`` from x towards y; order 1 is a Gaussian, above a super-Gaussian. The
    theodolite's spot has 12 mm at 10 m (App. A.3).
    """

    power_mw: float = 3.0
    diameters_mm: tuple[float, float] = (12.0, 11.0)
    angle_rad: float = 0.3
    order: float = 1.0

    @property
    def peak_mw_per_mm2(self) -> float:
        """The irradiance on the axis, on a surface across the beam."""
        a_mm, b_mm = (diameter / 2.0 for diameter in self.diameters_mm)
        area_mm2 = math.pi * a_mm * b_mm * math.gamma(1.0 + 1.0 / self.order) / 2.0 ** (1.0 / self.order)
        return float(self.power_mw / area_mm2)


@dataclass(frozen=True, slots=True)
class Footprint:
    """A beam's irradiance on a plane of constant z, around (x, y).

    ``form`` (xx, xy, yy) in 1/mm² gives ρ² = xx·dx² + 2·xy·dx·dy + yy·dy²; it holds the elongation by
    1/cos of a beam that comes in aslant, and ``peak_mw_per_mm2`` the matching loss by cos. ``shadow`` is
    that of dust which the beam has passed.
    """

    x_mm: float
    y_mm: float
    form: tuple[float, float, float]
    order: float
    peak_mw_per_mm2: float
    shadow: Shadow | None = None

    def irradiance(
        self, x_mm: npt.NDArray[np.float32], y_mm: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        """Irradiance in mW/mm² at points of the plane, any shape."""
        dx, dy = x_mm - np.float32(self.x_mm), y_mm - np.float32(self.y_mm)
        xx, xy, yy = (np.float32(term) for term in self.form)
        rho2 = dx * (xx * dx + (xy + xy) * dy) + yy * dy * dy
        if self.order != 1.0:
            rho2 = np.maximum(rho2, 0.0) ** np.float32(self.order)
        irradiance: npt.NDArray[np.float32] = np.exp(np.float32(-2.0) * rho2)
        irradiance *= np.float32(self.peak_mw_per_mm2)
        if self.shadow is not None:
            irradiance *= self.shadow.at(x_mm, y_mm)
        return irradiance

    @property
    def half_box_mm(self) -> tuple[float, float]:
        """Half width and half height of the box that holds all but the last of the tail."""
        xx, xy, yy = self.form
        rho2 = (-0.5 * math.log(TAIL_CUTOFF)) ** (1.0 / self.order)
        determinant = xx * yy - xy * xy
        return math.sqrt(rho2 * yy / determinant), math.sqrt(rho2 * xx / determinant)


def footprint(laser: Laser, pose: BeamPose, z_mm: float, share: float = 1.0) -> Footprint:
    """The light of ``share`` of the laser's power on the plane at ``z_mm``."""
    direction = np.array([pose.slope_x, pose.slope_y, 1.0])
    direction /= np.linalg.norm(direction)
    first = np.array([math.cos(laser.angle_rad), math.sin(laser.angle_rad), 0.0])
    first -= direction * (first @ direction)
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    across = np.array([first[:2] / (laser.diameters_mm[0] / 2.0), second[:2] / (laser.diameters_mm[1] / 2.0)])
    form = across.T @ across
    x_mm, y_mm = pose.at(z_mm)
    return Footprint(
        x_mm,
        y_mm,
        (float(form[0, 0]), float(form[0, 1]), float(form[1, 1])),
        laser.order,
        laser.peak_mw_per_mm2 * float(direction[2]) * share,
    )
