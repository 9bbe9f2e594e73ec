"""Dust and grease that settle on window and plate after the calibration.

Dust is opaque; a smear absorbs a few hundredths of the light and has no edge. On the window they are between
the laser and the ink, or between the ink and its camera, which is equivalent for a spot on the ink, and they
cast a shadow on the rear target. On the plate they hide it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from hw_sim.image import Image
from hw_sim.targets import soft_disc

SPECKS, SMEARS = 1000, 30
"""Numbers on a target with the heaviest dust: specks cover 1 % of it, seven are in a spot of 12 mm."""

SPECK_DIAMETERS_MM = (0.1, 1.0)
SMEAR_SIGMAS_MM = (2.0, 15.0)
SMEAR_LOSS = (0.01, 0.05)

HALF_MM = (78.0, 63.0)
"""Half of the surface on which it settles; beyond that the glass is clean."""

CELL_MM = 0.1

SHADOW_SIGMA_MM = 0.3
"""Blur of a speck's shadow by diffraction on the way to the rear target, 1 sigma: about half of √(λ D), 0.43
mm."""


@dataclass(frozen=True, slots=True, eq=False)
class Dust:
    """Transmission of a surface, (rows, columns) in cells of ``CELL_MM``, from the smallest x, y."""

    transmission: Image

    def at(self, x_mm: Image, y_mm: Image) -> Image:
        """Transmission at points of the surface, (rows, columns)."""
        columns = (x_mm + np.float32(HALF_MM[0])) / np.float32(CELL_MM) - np.float32(0.5)
        rows = (y_mm + np.float32(HALF_MM[1])) / np.float32(CELL_MM) - np.float32(0.5)
        share = cv2.remap(
            self.transmission,
            columns,
            rows,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=1.0,
        )
        return share.astype(np.float32, copy=False)

    def blurred(self, sigma_mm: float) -> Dust:
        """Transmission of the shadow far behind the surface, with this blur."""
        return Dust(cv2.GaussianBlur(self.transmission, (0, 0), sigma_mm / CELL_MM).astype(np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class Shadow:
    """Shadow of dust along a beam on a plane behind it, displaced by ``shift_mm`` from the dust."""

    dust: Dust
    shift_mm: tuple[float, float]

    def at(self, x_mm: Image, y_mm: Image) -> Image:
        """Share of the beam that arrives at points of the plane, (rows, columns)."""
        return self.dust.at(x_mm - np.float32(self.shift_mm[0]), y_mm - np.float32(self.shift_mm[1]))


def make_dust(amount: float, rng: np.random.Generator) -> Dust:
    """Draw dust of 0 to 1 (heavy); from the same generator state, more dust contains all of less.

    Raises ValueError for another amount.
    """
    if not 0.0 <= amount <= 1.0:
        raise ValueError(f"dust of {amount:g} is not between 0 and 1")
    size = (round(2.0 * HALF_MM[1] / CELL_MM), round(2.0 * HALF_MM[0] / CELL_MM))
    transmission = np.ones(size, dtype=np.float32)
    places = rng.uniform(-1.0, 1.0, (SPECKS + SMEARS, 2)) * HALF_MM
    log_min, log_max = (math.log(diameter) for diameter in SPECK_DIAMETERS_MM)
    diameters = np.exp(rng.uniform(log_min, log_max, SPECKS))
    sigmas = rng.uniform(*SMEAR_SIGMAS_MM, (SMEARS, 2))
    losses = rng.uniform(*SMEAR_LOSS, SMEARS)
    for place, diameter in zip(places[:SPECKS], diameters[: round(amount * SPECKS)], strict=False):
        here, across, up = _around(place, (diameter, diameter), size)
        transmission[here] *= np.float32(1.0) - soft_disc(np.hypot(across, up), diameter / 2.0, CELL_MM)
    for place, sigma, loss in zip(places[SPECKS:], sigmas[: round(amount * SMEARS)], losses, strict=False):
        here, across, up = _around(place, 4.0 * sigma, size)
        gaussian = np.exp(-0.5 * ((across / np.float32(sigma[0])) ** 2 + (up / np.float32(sigma[1])) ** 2))
        transmission[here] *= np.float32(1.0) - np.float32(loss) * gaussian
    return Dust(transmission)


def _around(
    place_mm: tuple[float, float], reach_mm: tuple[float, float], size: tuple[int, int]
) -> tuple[tuple[slice, slice], Image, Image]:
    """Cells within reach of a place, and their distances from it along x and y in mm."""
    spans, distances = [], []
    for half, at, reach, cells in zip(HALF_MM, place_mm, reach_mm, reversed(size), strict=True):
        low = max(math.floor((at - reach + half) / CELL_MM), 0)
        high = min(math.ceil((at + reach + half) / CELL_MM) + 1, cells)
        spans.append(slice(low, high))
        middles = (np.arange(low, high, dtype=np.float32) + np.float32(0.5)) * np.float32(CELL_MM)
        distances.append(middles - np.float32(half + at))
    across, up = np.meshgrid(*distances)
    return (spans[1], spans[0]), across, up
