"""Speckle of the laser's light itself, which no lamp shows.

A rough target that scatters coherent light makes subjective speckle in the image: its grain is the lens's
Airy disc (λ·F ≈ 2.6 µm at F/4), finer than a pixel of 6 µm, which holds about five grains and whose contrast
is therefore below one; polarisation, and scattering within the volume of ink or plate, lower it further. The
contrast given is that of one pixel.

Target and camera are fixed to each other, so the pattern stays as long as the light does. Light at another
angle shifts the scattered field across the lens's pupil: an angle that the pupil subtends at the target,
(f/F)/distance, replaces the field, and the pattern with it. Moving a beam with a plane wavefront would change
nothing. A curved wavefront changes the local angle with the place, and a beam with structure of its own its
phase; both depend on the laser, so ``place_mm`` is a setting, not a result. Vibration moves place and angle
within an exposure, whose light is then the mean over several patterns.
"""

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np

from hw_sim.beam import Footprint
from hw_sim.image import Image
from hw_sim.lens import HEIGHT_PX, WIDTH_PX

SHIFTS = 512
"""Number of positions along each axis of the field at which a pattern can start."""

GRAIN_SIGMA_PX = 0.4
"""Blur after which neighbouring pixels have a correlation of 0.09, as areas of 6 µm with grains of 2.6 µm."""

MIN_INK = 0.05
"""Share of ink below which the contrast stops growing: such a pixel hardly shows the spot."""


@dataclass(frozen=True, slots=True, eq=False)
class LaserSpeckle:
    """Factors of mean 1 for each pixel, which depend on position and angle of the beam.

    ``field`` holds standard normals. The patterns of beams that differ by ``place_mm`` or ``angle_rad`` along
    one axis have little in common; in between the pattern changes gradually, with the same contrast.
    """

    field: Image
    contrast: Image | float
    place_mm: float
    angle_rad: float

    def factor(self, region: tuple[slice, slice], spot: Footprint) -> Image:
        """Factors at the pixels of a region for this beam, (rows, columns)."""
        rows, columns = region
        at = (
            spot.x_mm / self.place_mm,
            spot.y_mm / self.place_mm,
            spot.slopes[0] / self.angle_rad,
            spot.slopes[1] / self.angle_rad,
        )
        pattern = np.zeros((rows.stop - rows.start, columns.stop - columns.start), dtype=np.float32)
        for corner in itertools.product((0, 1), repeat=len(at)):
            weight, key = 1.0, 0
            for position, up in zip(at, corner, strict=True):
                cell = math.floor(position)
                # Squares of cosine and sine add up to 1: the variance is the same between the corners.
                turn = 0.5 * math.pi * (position - cell)
                weight *= math.sin(turn) if up else math.cos(turn)
                key = (key * 0x9E3779B1 + cell + up + 0x7F4A7C15) % 0xFFFFFFFB
            down, right = divmod(key % SHIFTS**2, SHIFTS)
            pattern += (
                np.float32(weight)
                * (
                    self.field[
                        down + rows.start : down + rows.stop, right + columns.start : right + columns.stop
                    ]
                )
            )
        pattern *= self.contrast[region] if isinstance(self.contrast, np.ndarray) else self.contrast
        factor: Image = np.maximum(np.float32(1.0) + pattern, np.float32(0.0))
        return factor


def make_laser_speckle(
    rng: np.random.Generator, contrast: float, place_mm: float, angle_rad: float, ink: Image | None
) -> LaserSpeckle:
    """Speckle of one camera's picture; ``ink`` is the share of each pixel that a print covers, None for all.

    A pixel partly covered by ink holds fewer grains, and its contrast grows with 1/√share.
    """
    seen = contrast if ink is None else contrast / np.sqrt(np.clip(ink, MIN_INK, 1.0)).astype(np.float32)
    white = rng.standard_normal((HEIGHT_PX + SHIFTS, WIDTH_PX + SHIFTS), dtype=np.float32)
    field = cv2.GaussianBlur(white, (0, 0), GRAIN_SIGMA_PX)
    return LaserSpeckle((field / field.std()).astype(np.float32), seen, place_mm, angle_rad)
