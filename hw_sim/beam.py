"""The reference beam: its path in the unit frame, and its irradiance on a target."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from hw_sim.image import Image

RIM = 0.05
"""Width of the soft rim that diffraction gives to a clipped beam, in half diameters: 0.3 mm of 6 mm."""

TAIL_CUTOFF = 1e-6
"""Share of the peak below which the beam is not rendered: 0.02 counts of 16 bits."""


@dataclass(frozen=True, slots=True)
class BeamPose:
    """A beam that crosses z = 0 at (x, y) mm, with dimensionless slopes (dx/dz, dy/dz)."""

    x_mm: float
    y_mm: float
    slope_x: float = 0.0
    slope_y: float = 0.0

    @property
    def yaw_deg(self) -> float:
        """Angle of the beam in the plane of x and z."""
        return math.degrees(math.atan(self.slope_x))

    @property
    def pitch_deg(self) -> float:
        """Angle of the beam in the plane of y and z."""
        return math.degrees(math.atan(self.slope_y))

    def at(self, z_mm: float) -> tuple[float, float]:
        """Intersection of the beam with the plane at ``z_mm``, (x, y) in mm."""
        return self.x_mm + self.slope_x * z_mm, self.y_mm + self.slope_y * z_mm


def glass_shift_mm(pose: BeamPose, glass_mm: float, index: float) -> tuple[float, float]:
    """Displacement (x, y) of a beam by plane glass, on all planes behind it, mm.

    Snell's law, sin θ = n sin θ': within glass of thickness t the beam moves sideways by t·tan θ' instead of
    t·tan θ, and leaves in its original direction. The shift is therefore −t·(tan θ − tan θ') along the slope.
    """
    slope = math.hypot(pose.slope_x, pose.slope_y)
    if glass_mm == 0.0 or slope == 0.0:
        return 0.0, 0.0
    sine = slope / math.sqrt(1.0 + slope * slope) / index
    share = glass_mm * (sine / math.sqrt(1.0 - sine * sine) / slope - 1.0)
    return share * pose.slope_x, share * pose.slope_y


@dataclass(frozen=True, slots=True)
class BeamFlaws:
    """Deviations of a beam's profile from the elliptical profile, about its centroid.

    The true position of a beam is the centroid of all its light except the halo, which is centred on it.
    Lengths are in half diameters of the beam.

    ``skew``, −0.5 to 0.5: along the first axis the profile is (1 + skew) times as wide on the positive side
    of its peak, (1 − skew) times on the other; the power is unchanged. ``aperture``: radius around the peak
    (of the skewed profile) beyond which the light is cut. ``halo_share`` of the power is a Gaussian,
    ``halo_ratio`` times as wide as the beam.
    """

    skew: float = 0.0
    aperture: float = math.inf
    halo_share: float = 0.0
    halo_ratio: float = 2.5

    def peak_offset(self, order: float) -> float:
        """Distance from the peak to the centroid along the first axis, in half diameters."""
        return 2.0 * self.skew * _mean_distance(order, self.aperture)

    def profile(
        self, p: npt.NDArray[np.float32], q: npt.NDArray[np.float32], order: float
    ) -> npt.NDArray[np.float32]:
        """Irradiance at (p, q) half diameters off the centroid, relative to the peak without flaws."""
        halo_peak = self.halo_share * 2.0 * math.gamma(1.0 + 1.0 / order) / 2.0 ** (1.0 / order)
        halo_peak /= self.halo_ratio**2
        halo = np.float32(halo_peak) * np.exp(np.float32(-2.0 / self.halo_ratio**2) * (p * p + q * q))
        along = p + np.float32(self.peak_offset(order))
        along /= np.where(along > 0.0, np.float32(1.0 + self.skew), np.float32(1.0 - self.skew))
        rho2 = along * along + q * q
        core = np.exp(np.float32(-2.0) * rho2 ** np.float32(order))
        if math.isfinite(self.aperture):
            core *= _passed(np.sqrt(rho2), self.aperture)
        light: npt.NDArray[np.float32] = halo + np.float32(1.0 - self.halo_share) * core
        return light

    def reach(self, order: float) -> float:
        """Distance from the centroid beyond which all light is below the cut-off, in half diameters."""
        whole = math.sqrt(-0.5 * math.log(TAIL_CUTOFF))
        core = min(math.pow(whole, 1.0 / order), self.aperture + RIM) * (1.0 + abs(self.skew))
        core += abs(self.peak_offset(order))
        return max(core, self.halo_ratio * whole) if self.halo_share else core


def _passed(rho: npt.NDArray[Any], aperture: float) -> npt.NDArray[Any]:
    """Share of the light that passes an aperture with a soft rim."""
    return np.clip((aperture - rho) / np.float32(RIM) + np.float32(0.5), 0.0, 1.0)


@lru_cache(maxsize=16)
def _mean_distance(order: float, aperture: float) -> float:
    """Mean of |p| over a beam of this order, cut by the aperture; 1/√(2π) for a complete Gaussian."""
    rho = np.linspace(0.0, min((-0.5 * math.log(1e-12)) ** (0.5 / order), aperture + RIM), 20_001)
    light = np.exp(-2.0 * rho ** (2.0 * order)) * (_passed(rho, aperture) if math.isfinite(aperture) else 1.0)
    return float(2.0 / math.pi * (rho * rho * light).sum() / (rho * light).sum())


@dataclass(frozen=True, slots=True)
class Laser:
    """The reference laser (App. A.1: 1–5 mW, ellipse or circle up to 15 mm).

    The profile across the beam is exp(−2 ρ^(2·order)), ρ = 1 on the ellipse of the 1/e² diameters, whose
    first axis is turned by ``angle_rad`` from x towards y; order 1 is a Gaussian, higher orders are
    super-Gaussian. The theodolite's spot has 12 mm at 10 m (App. A.3). ``flaws`` are deviations from that
    profile.
    """

    power_mw: float = 3.0
    diameters_mm: tuple[float, float] = (12.0, 11.0)
    angle_rad: float = 0.3
    order: float = 1.0
    flaws: BeamFlaws | None = None

    @property
    def peak_mw_per_mm2(self) -> float:
        """Irradiance on the axis, on a surface perpendicular to the beam."""
        a_mm, b_mm = (diameter / 2.0 for diameter in self.diameters_mm)
        area_mm2 = math.pi * a_mm * b_mm * math.gamma(1.0 + 1.0 / self.order) / 2.0 ** (1.0 / self.order)
        return float(self.power_mw / area_mm2)


class Factor(Protocol):
    """A factor of a spot's light."""

    def at(self, x_mm: Image, y_mm: Image, /) -> Image:
        """The factor at points of the plane, any shape."""
        ...


@dataclass(frozen=True, slots=True)
class Footprint:
    """Irradiance of a beam on a plane of constant z, around (x, y).

    ``form`` (xx, xy, yy) in 1/mm² gives ρ² = xx·dx² + 2·xy·dx·dy + yy·dy²; it includes the elongation by
    1/cos of an oblique beam, and ``peak_mw_per_mm2`` the corresponding loss by cos. ``shadow`` is the shadow
    of dust in the beam's path, or another factor by place. ``slopes`` are the slopes of the beam. With
    ``flaws``, ``axes`` (px, py, qx, qy) in 1/mm convert an offset to half diameters along the beam's two
    axes.
    """

    x_mm: float
    y_mm: float
    form: tuple[float, float, float]
    order: float
    peak_mw_per_mm2: float
    shadow: Factor | None = None
    slopes: tuple[float, float] = (0.0, 0.0)
    flaws: BeamFlaws | None = None
    axes: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def irradiance(
        self, x_mm: npt.NDArray[np.float32], y_mm: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        """Irradiance in mW/mm² at points of the plane, any shape."""
        dx, dy = x_mm - np.float32(self.x_mm), y_mm - np.float32(self.y_mm)
        irradiance: npt.NDArray[np.float32]
        if self.flaws is not None:
            px, py, qx, qy = (np.float32(term) for term in self.axes)
            irradiance = self.flaws.profile(px * dx + py * dy, qx * dx + qy * dy, self.order)
        else:
            xx, xy, yy = (np.float32(term) for term in self.form)
            rho2 = dx * (xx * dx + (xy + xy) * dy) + yy * dy * dy
            if self.order != 1.0:
                rho2 = np.maximum(rho2, 0.0) ** np.float32(self.order)
            irradiance = np.exp(np.float32(-2.0) * rho2)
        irradiance *= np.float32(self.peak_mw_per_mm2)
        if self.shadow is not None:
            irradiance *= self.shadow.at(x_mm, y_mm)
        return irradiance

    @property
    def half_box_mm(self) -> tuple[float, float]:
        """Half width and half height of the box that holds all light above the cut-off."""
        xx, xy, yy = self.form
        rho2 = (-0.5 * math.log(TAIL_CUTOFF)) ** (1.0 / self.order)
        if self.flaws is not None:
            rho2 = self.flaws.reach(self.order) ** 2
        determinant = xx * yy - xy * xy
        return math.sqrt(rho2 * yy / determinant), math.sqrt(rho2 * xx / determinant)


def footprint(laser: Laser, pose: BeamPose, z_mm: float, share: float = 1.0) -> Footprint:
    """Light of ``share`` of the laser's power on the plane at ``z_mm``."""
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
        slopes=(pose.slope_x, pose.slope_y),
        flaws=laser.flaws,
        axes=(float(across[0, 0]), float(across[0, 1]), float(across[1, 0]), float(across[1, 1])),
    )
