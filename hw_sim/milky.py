"""A window of milky glass, which scatters the passing beam, in place of a print."""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from altd.records import FloatArray
from hw_sim.beam import BeamPose, Footprint
from hw_sim.image import Image
from hw_sim.lens import Lens

LOBES = 16
"""Gaussians that make up the light behind the window."""


@dataclass(frozen=True, slots=True)
class MilkyGlass:
    """A window that scatters the share ``haze`` of the light that passes it; the rest passes straight.

    Ground glass scatters about the beam's direction, with a radiant intensity of cosⁿ of the angle that is
    half at ``half_angle_deg``, below 60. Without ``half_angle_deg`` it is opal glass: its volume scatters
    until the direction is lost (Lambertian, n = 1, about the normal). ``blur_mm`` is the sigma along each
    axis by which scattering within the glass widens the spot that its camera sees.
    """

    haze: float
    half_angle_deg: float | None = None
    blur_mm: float = 0.0

    @property
    def exponent(self) -> float:
        """The n of cosⁿ."""
        if self.half_angle_deg is None:
            return 1.0
        return math.log(0.5) / math.log(math.cos(math.radians(self.half_angle_deg)))

    def front(self, spot: Footprint, reflectance: float, lens: Lens) -> list[Footprint]:
        """The spot on the window as a camera behind it sees it, on a surface of that reflectance.

        ``spot`` has the light that passes. Towards the camera a Lambertian surface of reflectance ρ has the
        radiance ρ/π per irradiance, the glass haze (n + 1)/(2π) cosⁿθ / cos θ₀: θ is the angle from the beam,
        θ₀ from the normal.
        """
        n = self.exponent
        gain = 0.5 * self.haze * (n + 1.0) / reflectance
        lobe = None if self.half_angle_deg is None else _Lobe(n, spot.slopes, lens)
        return [replace(_widened(spot, self.blur_mm, gain), shadow=lobe)]

    def rear(self, spot: Footprint, pose: BeamPose, distance_mm: float) -> list[Footprint]:
        """The light on a plane behind the window, of the ``spot`` that clear glass would let through.

        A point of the window lights the plane with (n + 1)/(2π D²) cosⁿ⁺³θ: a mean of Gaussians r² ↦
        exp(−t r²/D²) over a gamma distribution of t of the order (n + 1)/2. The Gaussian beam is convolved
        with each; the power is unchanged. The lobe of a slanted beam is that of a normal one.
        """
        direct = replace(spot, peak_mw_per_mm2=(1.0 - self.haze) * spot.peak_mw_per_mm2)
        if self.half_angle_deg is None:
            spot = replace(spot, x_mm=pose.x_mm, y_mm=pose.y_mm)
        sigmas_mm = distance_mm / np.sqrt(2.0 * gamma_means(0.5 * (self.exponent + 1.0), LOBES))
        return [direct, *(_widened(spot, sigma_mm, self.haze / LOBES) for sigma_mm in sigmas_mm.tolist())]


@dataclass(frozen=True, slots=True, eq=False)
class _Lobe:
    """Factor of the scattered light towards a camera, by the place on the window."""

    exponent: float
    slopes: tuple[float, float]
    lens: Lens

    def at(self, x_mm: Image, y_mm: Image) -> Image:
        camera = -self.lens.rotation.T @ self.lens.translation_mm
        side = -1.0 if self.lens.mirrored else 1.0
        to_x, to_y = side * camera[0] - x_mm, -camera[1] - y_mm
        to_z = abs(float(camera[2]))
        length = np.sqrt(to_x * to_x + to_y * to_y + to_z * to_z)
        along = to_x * self.slopes[0] + to_y * self.slopes[1] + to_z
        along /= length * math.sqrt(1.0 + self.slopes[0] ** 2 + self.slopes[1] ** 2)
        factor: Image = (along**self.exponent * length / to_z).astype(np.float32)
        return factor


def _widened(spot: Footprint, sigma_mm: float, share: float) -> Footprint:
    """``share`` of a Gaussian spot, convolved with a round Gaussian."""
    xx, xy, yy = spot.form
    form = np.array([[xx, xy], [xy, yy]])
    covariance_mm2 = np.linalg.inv(4.0 * form)
    wider_mm2 = covariance_mm2 + sigma_mm**2 * np.eye(2)
    (xx, xy), (_, yy) = np.linalg.inv(4.0 * wider_mm2).tolist()
    dimmer = share * math.sqrt(np.linalg.det(covariance_mm2) / np.linalg.det(wider_mm2))
    peak = dimmer * spot.peak_mw_per_mm2
    return replace(spot, form=(xx, xy, yy), peak_mw_per_mm2=peak, flaws=None, shadow=None)


def gamma_means(order: float, count: int) -> FloatArray:
    """Means of a gamma distribution of that order within ``count`` intervals of equal probability."""
    t = np.geomspace(1e-9, 1.0, 40_001) * (order + 12.0 * math.sqrt(order) + 30.0)
    log_density = (order - 1.0) * np.log(t) - t - math.lgamma(order)
    weight = np.exp(log_density) * np.gradient(t)
    cumulated = np.cumsum(weight) / weight.sum()
    moments = np.cumsum(weight * t) / weight.sum()
    ends: npt.NDArray[np.float64] = np.interp(np.linspace(0.0, 1.0, count + 1), cumulated, moments)
    ends[0] = 0.0
    return np.asarray(count * np.diff(ends))
