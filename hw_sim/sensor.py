"""The camera's sensor: from mean electrons to grey values, with noise.

Two methods have the same statistics. ``expose`` draws photons for each pixel (recordings). In real time,
where a frame must take about a millisecond, Gaussian noise is taken from a pool that was drawn once
(``NoisePool``).
"""

from dataclasses import dataclass

import numpy as np

from altd.records import PixelArray
from hw_sim.image import Image

FULL_WELL_E = 15_000.0
READ_NOISE_E = 40.0
BLACK_LEVEL = 0.016
"""Offset of the grey values, as a share of full scale: 4 counts of 8 bits."""

POOL_SIZE = 1 << 21


@dataclass(frozen=True, slots=True)
class Sensor:
    """A global-shutter sensor, read with ``bits`` of 8 to 16. At gain 1 a full well is full scale."""

    bits: int = 8

    @property
    def full_scale(self) -> int:
        """Largest grey value."""
        return (1 << self.bits) - 1

    def counts_per_electron(self, gain: float) -> float:
        """Slope of the grey values."""
        return self.full_scale / FULL_WELL_E * gain

    def expose(self, mean_e: Image, gain: float, rng: np.random.Generator) -> PixelArray:
        """Grey values of a frame of ``mean_e`` electrons: Poisson photons, Gaussian read-out."""
        collected = np.minimum(rng.poisson(mean_e).astype(np.float32), np.float32(FULL_WELL_E))
        collected += np.float32(READ_NOISE_E) * rng.standard_normal(mean_e.shape, dtype=np.float32)
        return self.quantise(self.mean_counts(collected, gain))

    def mean_counts(self, electrons: Image, gain: float) -> Image:
        """Grey values before quantisation; electrons are limited to the full well."""
        held = np.minimum(electrons, np.float32(FULL_WELL_E))
        slope = np.float32(self.counts_per_electron(gain))
        return held * slope + np.float32(BLACK_LEVEL * self.full_scale)

    def noise_counts(self, mean_e: Image, gain: float) -> Image:
        """Standard deviation of the grey values: shot noise of the electrons and read noise."""
        held = np.minimum(mean_e, np.float32(FULL_WELL_E))
        slope = np.float32(self.counts_per_electron(gain))
        return slope * np.sqrt(held + np.float32(READ_NOISE_E**2))

    def quantise(self, counts: Image) -> PixelArray:
        """Whole grey values within the scale; ``counts`` is overwritten."""
        counts += np.float32(0.5)
        np.clip(counts, 0.0, self.full_scale, out=counts)
        return counts.astype(np.uint8) if self.bits <= 8 else counts.astype(np.uint16)


class NoisePool:
    """Standard normal numbers drawn once; each frame uses a section that starts at its own position."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._numbers = rng.standard_normal(POOL_SIZE, dtype=np.float32)

    def stretch(self, key: int, shape: tuple[int, int]) -> Image:
        """Noise (rows, columns) for the frame ``key``; the same key gives the same noise."""
        size = shape[0] * shape[1]
        # Weyl's sequence on the golden ratio: sections of successive frames are far apart in the pool.
        start = int(key * 0.6180339887498949 % 1.0 * (POOL_SIZE - size))
        return self._numbers[start : start + size].reshape(shape)
