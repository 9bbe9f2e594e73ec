"""Scattering surfaces: the printed window, the plain plate, their speckle; positions of the frame LEDs."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hw_sim.image import Image

DOT_DIAMETER_MM = 0.5
DOT_PITCH_MM = 1.0
"""Pitch of the screen print in Table 3.1's last row."""

WINDOW_TRANSMISSION = 0.92
"""Transmission of clear glass with two uncoated surfaces."""

LED_DIAMETER_MM = 5.0
LED_POSITIONS_MM = ((-74.0, 48.0), (0.0, 59.0), (74.0, 48.0), (-74.0, -48.0), (0.0, -59.0), (74.0, -48.0))
"""Six frame LEDs (Sec. 3.4, App. A.3): outside the measured 140 × 110 mm, within the picture."""


@dataclass(frozen=True, slots=True)
class DotPattern:
    """Print of a window: round dots on a hexagonal or an orthogonal (square) lattice.

    ``size_mm`` is the width and height of the print, centred on the window and turned with its rows; None: it
    extends beyond the picture.
    """

    diameter_mm: float = DOT_DIAMETER_MM
    pitch_mm: float = DOT_PITCH_MM
    hexagonal: bool = True
    size_mm: tuple[float, float] | None = None

    @property
    def coverage(self) -> float:
        """Share of the window that the dots cover; the rest of the beam reaches the rear target."""
        if self.hexagonal:
            return math.pi * self.diameter_mm**2 / (2.0 * math.sqrt(3.0) * self.pitch_mm**2)
        return math.pi * self.diameter_mm**2 / (4.0 * self.pitch_mm**2)


@dataclass(frozen=True, slots=True, eq=False)
class PrintFlaws:
    """Flaws of each dot of a digital print (Fig. 3.8 left, Table 3.1), from a table of standard normals.

    ``jitter_mm`` is the standard deviation of a dot's position per axis. ``bleed_mm`` is the standard
    deviation of the ink's run beyond (or short of) the drawn edge, one value for each dot, and the width over
    which every edge fades. ``normals`` (2, n, n, 3): of the lattice's two parts, the dots repeat after n rows
    and columns.
    """

    jitter_mm: float
    bleed_mm: float
    normals: npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class DotPrint:
    """A printed pattern: the position of one dot (mm), and the turn of the rows from x towards y."""

    phase_mm: tuple[float, float]
    rotation_rad: float
    pattern: DotPattern = DotPattern()
    flaws: PrintFlaws | None = None

    def cover(self, x_mm: Image, y_mm: Image, softness_mm: float) -> Image:
        """Share of ink, 0 to 1, in a small cell of about ``softness_mm`` at points of the window."""
        cos, sin = np.float32(math.cos(self.rotation_rad)), np.float32(math.sin(self.rotation_rad))
        x, y = x_mm - np.float32(self.phase_mm[0]), y_mm - np.float32(self.phase_mm[1])
        across, up = cos * x + sin * y, cos * y - sin * x
        pattern = self.pattern
        pitch = np.float32(pattern.pitch_mm)
        offsets: tuple[float, ...] = (0.0,)
        row = pitch
        if pattern.hexagonal:  # two rectangular lattices, one centred in the other
            row, offsets = np.float32(pattern.pitch_mm * math.sqrt(3.0)), (0.0, 0.5)
        radius_mm = pattern.diameter_mm / 2.0
        if self.flaws is not None:
            distances = [
                _beyond_flawed_dot(across, up, offset, (pitch, row), self.flaws)
                for offset in map(np.float32, offsets)
            ]
            distance = np.minimum.reduce(distances)
            softness_mm = math.hypot(softness_mm, self.flaws.bleed_mm)
        else:
            squared = [
                (across - offset * pitch - pitch * np.rint(across / pitch - offset)) ** 2
                + (up - offset * row - row * np.rint(up / row - offset)) ** 2
                for offset in map(np.float32, offsets)
            ]
            distance = np.sqrt(np.minimum.reduce(squared))
        ink = soft_disc(distance, radius_mm, softness_mm)
        if pattern.size_mm is not None:
            half_x, half_y = (np.float32(size / 2.0) for size in pattern.size_mm)
            ink *= (np.abs(cos * x_mm + sin * y_mm) < half_x) & (np.abs(cos * y_mm - sin * x_mm) < half_y)
        return ink


def _beyond_flawed_dot(
    across: Image, up: Image, offset: np.float32, pitches: tuple[np.float32, np.float32], flaws: PrintFlaws
) -> Image:
    """Distance from the nearest dot's centre, less the run of its ink, in one part of the lattice, mm."""
    column, row = np.rint(across / pitches[0] - offset), np.rint(up / pitches[1] - offset)
    n = flaws.normals.shape[1]
    drawn = flaws.normals[int(offset > 0.0)][row.astype(np.int64) % n, column.astype(np.int64) % n]
    aside = across - (column + offset) * pitches[0] - np.float32(flaws.jitter_mm) * drawn[..., 0]
    above = up - (row + offset) * pitches[1] - np.float32(flaws.jitter_mm) * drawn[..., 1]
    beyond: Image = np.hypot(aside, above) - np.float32(flaws.bleed_mm) * drawn[..., 2]
    return beyond


def speckle(rng: np.random.Generator, shape: tuple[int, int], contrast: float) -> Image:
    """Fixed factor of mean 1 by which the surface texture changes each pixel's light, (rows, columns).

    The texture is finer than a pixel, so its mean over one pixel's area differs from the next one's with
    ``contrast``, and the lens then blurs it like all else. Target and camera are fixed to each other: the
    texture belongs to the pixels.
    """
    texture = rng.standard_normal(shape, dtype=np.float32) * np.float32(contrast)
    factor: Image = np.maximum(np.float32(1.0) + texture - texture.mean(), np.float32(0.0))
    return factor


def soft_disc(distance_mm: Image, radius_mm: float, softness_mm: float) -> Image:
    """1 inside and 0 outside of a disc, with an edge as wide as the cell that is evaluated.

    A straight edge of width w adds π·w²/12 to the disc's area; the radius compensates for that.
    """
    radius_mm = math.sqrt(radius_mm**2 - softness_mm**2 / 12.0)
    edge = np.float32(0.5) + (np.float32(radius_mm) - distance_mm) / np.float32(softness_mm)
    cover: Image = np.clip(edge, np.float32(0.0), np.float32(1.0))
    return cover
