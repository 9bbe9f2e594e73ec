"""The light of one frame before any noise, and the noise for it.

A way that disturbs light changes mean electrons, from which the noise is drawn. Pictures are (rows, columns).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike

from altd.records import PixelArray
from hw_sim.beam import TAIL_CUTOFF
from hw_sim.image import Image
from hw_sim.sensor import Sensor

_POOL = 1 << 22


@dataclass(frozen=True, slots=True)
class SpotShape:
    """A laser spot: ``peak`` · exp(−2 ρ^(2·order)) with ρ² of ``form`` (uu, uv, vv) in 1/px²."""

    u_px: float
    v_px: float
    form: tuple[float, float, float]
    order: float
    peak: float

    @property
    def radius_px(self) -> float:
        """Radius of the circle with the area of the 1/e² ellipse."""
        uu, uv, vv = self.form
        return float((uu * vv - uv * uv) ** -0.25)

    def moved(self, du_px: float, dv_px: float) -> SpotShape:
        """The same spot at another position."""
        return replace(self, u_px=self.u_px + du_px, v_px=self.v_px + dv_px)

    def scaled(self, scale: float, share: float) -> SpotShape:
        """The spot ``scale`` times as wide, with ``share`` of the light."""
        uu, uv, vv = self.form
        by = scale**-2
        return replace(self, form=(uu * by, uv * by, vv * by), peak=self.peak * share * by)

    def window(self, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """Rows and columns that hold the spot."""
        uu, uv, vv = self.form
        rho2 = (-0.5 * math.log(TAIL_CUTOFF)) ** (1.0 / self.order)
        determinant = uu * vv - uv * uv
        half_u, half_v = math.sqrt(rho2 * vv / determinant), math.sqrt(rho2 * uu / determinant)
        return _span(self.v_px, half_v, shape[0]), _span(self.u_px, half_u, shape[1])

    def light(self, rows: slice, columns: slice) -> Image:
        """Irradiance in a part of the picture."""
        du = np.arange(columns.start, columns.stop, dtype=np.float32)[None, :] - np.float32(self.u_px)
        dv = np.arange(rows.start, rows.stop, dtype=np.float32)[:, None] - np.float32(self.v_px)
        uu, uv, vv = (np.float32(term) for term in self.form)
        rho2 = uu * du * du + (uv + uv) * du * dv + vv * dv * dv
        if self.order != 1.0:
            rho2 = np.maximum(rho2, 0.0) ** np.float32(self.order)
        light: Image = np.float32(self.peak) * np.exp(np.float32(-2.0) * rho2)
        return light


def _span(middle: float, half: float, size: int) -> slice:
    low = min(max(math.floor(middle - half), 0), size)
    return slice(low, min(max(math.ceil(middle + half) + 1, low), size))


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Light on one camera at one instant, in electrons: the laser's light, and all other light.

    ``response`` is the signal of a pixel for an irradiance on the target, in the unit of the spot's ``peak``.
    """

    camera: str
    beam: Image
    rest: Image
    response: Image
    spot: SpotShape
    px_per_mm: float

    @property
    def electrons(self) -> Image:
        """Mean electrons of the frame."""
        return self.beam + self.rest

    def beam_times(self, gain: Image | float) -> Scene:
        """Scene with the laser's light attenuated before the target."""
        return replace(self, beam=self.beam * np.asarray(gain, np.float32))

    def all_times(self, gain: Image | float) -> Scene:
        """Scene with all light attenuated between target and camera, or on the target."""
        factor = np.asarray(gain, np.float32)
        return replace(self, beam=self.beam * factor, rest=self.rest * factor)

    def beam_plus(self, spot: SpotShape) -> Scene:
        """Scene with more laser light on the target, through its print."""
        rows, columns = spot.window(self.beam.shape)
        beam = self.beam.copy()
        beam[rows, columns] += spot.light(rows, columns) * self.response[rows, columns]
        return replace(self, beam=beam)

    def lit(self, irradiance: Image | float) -> Scene:
        """Scene with more light of any kind on the target, through its print."""
        return replace(self, rest=self.rest + np.asarray(irradiance, np.float32) * self.response)

    def veiled(self, electrons: Image | float) -> Scene:
        """Scene with light that reaches the camera without meeting the target."""
        return replace(self, rest=self.rest + np.asarray(electrons, np.float32))

    def seen_as(self, electrons: ArrayLike) -> Scene:
        """The scene with all of its light replaced."""
        return self.all_times(0.0).veiled(np.asarray(electrons, np.float32))

    def without_laser(self) -> Scene:
        """The scene without the laser."""
        return replace(self, beam=np.zeros_like(self.beam))

    def with_laser(self, spot: SpotShape) -> Scene:
        """The scene with another spot instead of the laser's."""
        return self.without_laser().beam_plus(spot)

    def from_spot(self) -> tuple[Image, Image]:
        """Distances of the pixels right of and below the spot's centre, px: (1, columns) and (rows, 1)."""
        rows, columns = self.beam.shape
        right = np.arange(columns, dtype=np.float32)[None, :] - np.float32(self.spot.u_px)
        below = np.arange(rows, dtype=np.float32)[:, None] - np.float32(self.spot.v_px)
        return right, below

    def along(self, angle: float) -> Image:
        """Distance of the pixels from the spot's centre in a direction, px."""
        u, v = self.from_spot()
        return u * np.float32(math.cos(angle)) + v * np.float32(math.sin(angle))

    def edge(self, angle: float, at: float, soft_mm: float) -> Image:
        """0 beyond a straight edge and 1 before it: ``at`` radii from the spot's centre, ``soft_mm`` wide."""
        return self._edge_px(angle, at * self.spot.radius_px, soft_mm * self.px_per_mm)

    def stripe(self, angle: float, at: float, width_mm: float, soft_px: float) -> Image:
        """1 in a stripe across the picture, ``at`` radii from the spot's centre, 0 outside."""
        middle, half = at * self.spot.radius_px, width_mm * self.px_per_mm / 2
        return self._edge_px(angle, middle + half, soft_px) - self._edge_px(angle, middle - half, soft_px)

    def _edge_px(self, angle: float, at_px: float, soft_px: float) -> Image:
        along = self.along(angle) - np.float32(at_px)
        shadow: Image = np.clip(0.5 - along / np.float32(max(soft_px, 0.5)), 0.0, 1.0)
        return shadow

    def disc(self, angle: float, at: float, width_mm: float, soft_px: float) -> Image:
        """1 inside a disc, ``at`` radii from the spot's centre in a direction, 0 outside."""
        u, v = self.from_spot()
        right_px, down_px = (at * self.spot.radius_px * f(angle) for f in (math.cos, math.sin))
        far = np.sqrt((u - np.float32(right_px)) ** 2 + (v - np.float32(down_px)) ** 2)
        radius_px = np.float32(width_mm * self.px_per_mm / 2)
        disc: Image = np.clip(0.5 - (far - radius_px) / np.float32(max(soft_px, 0.5)), 0.0, 1.0)
        return disc


@dataclass(frozen=True, slots=True, eq=False)
class MeanImage:
    """Mean grey values of a scene and their noise (1 sigma), before quantisation."""

    counts: Image
    noise_counts: Image


def mean_image(electrons: Image, sensor: Sensor) -> MeanImage:
    """Mean grey values and noise of a sensor for mean electrons."""
    return MeanImage(sensor.mean_counts(electrons, 1.0), sensor.noise_counts(electrons, 1.0))


class Noise:
    """Standard normal numbers drawn once; each frame uses a section at a random position."""

    def __init__(self, seed: int) -> None:
        self._numbers = np.random.default_rng(seed).standard_normal(_POOL, dtype=np.float32)

    def picture(self, shape: tuple[int, ...], rng: np.random.Generator) -> Image:
        """Noise (rows, columns); read-only."""
        size = shape[0] * shape[1]
        start = int(rng.integers(_POOL - size))
        return self._numbers[start : start + size].reshape(shape)


def noisy_image(mean: MeanImage, noise: Image, bits: int) -> PixelArray:
    """Grey values of one frame."""
    counts = cv2.multiply(noise, mean.noise_counts)
    if bits <= 8:
        return np.asarray(cv2.add(counts, mean.counts, dtype=cv2.CV_8U), np.uint8)
    pixels = np.asarray(cv2.add(counts, mean.counts, dtype=cv2.CV_16U), np.uint16)
    return np.minimum(pixels, np.uint16((1 << bits) - 1))


def blurred(picture: Image, sigma_px: float) -> Image:
    """Picture after a Gaussian blur."""
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px), np.float32)
