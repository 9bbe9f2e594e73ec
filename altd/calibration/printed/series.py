"""How much light each place of a print sends to the camera: a Fourier series on its lattice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.calibration.printed.lattice import Lattice
from altd.calibration.printed.sample import Sample
from altd.records import ComplexArray, FloatArray

_RIDGE = 1e-6
_MOST_WEAKENED = 40.0
"""Radians² per px²: higher harmonics are weakened no further, or noise would stand for them."""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """F over the print's plane: ``mean``, then ``amplitudes``, a complex number a harmonic.

    Lens and pixel blur the picture alike everywhere, ``blur_px``, so where the picture of the print is small
    its harmonics are weaker; the amplitudes are those of the print itself.
    """

    lattice: Lattice
    mean: float
    amplitudes: ComplexArray
    blur_px: float

    @classmethod
    def fit(cls, lattice: Lattice, samples: Sequence[Sample], blurs_px: Sequence[float]) -> Series:
        """Weighted least squares through all samples; of some blurs the one that fits best."""
        mm = np.concatenate([sample.mm for sample in samples])
        ratio = np.concatenate([sample.ratio for sample in samples])
        weight = np.concatenate([sample.weight for sample in samples])
        counts = [len(sample.mm) for sample in samples]
        metrics = np.array([sample.metric for sample in samples])
        waves = lattice.waves(mm)
        half = waves.shape[1]
        fits = []
        for blur_px in blurs_px:
            blurred = waves * np.repeat(_dimming(lattice, metrics, blur_px), counts, axis=0)
            design = np.column_stack([np.ones(len(mm)), blurred.real, -blurred.imag])
            weighted = design * weight[:, None]
            normal = weighted.T @ design + _RIDGE * np.eye(design.shape[1])
            solution = np.linalg.solve(normal, weighted.T @ ratio)
            cost = float(weight @ np.square(ratio - design @ solution))
            amplitudes = solution[1 : 1 + half] + 1j * solution[1 + half :]
            fits.append((cost, cls(lattice, float(solution[0]), amplitudes, blur_px)))
        return min(fits, key=lambda fit: fit[0])[1]

    @property
    def contrast(self) -> float:
        """The weaker of the two fundamental waves, over the mean."""
        fundamental = np.abs(self.lattice.harmonics).sum(axis=1) == 1
        return float(np.abs(self.amplitudes[fundamental]).min() / self.mean)

    def at(self, mm: FloatArray, metrics: FloatArray) -> FloatArray:
        """F at points (n, 2) mm with their metrics (n, 2, 2) mm²/px²."""
        waves = self.lattice.waves(mm)
        waves *= _dimming(self.lattice, metrics, self.blur_px)
        response: FloatArray = self.mean + (waves @ self.amplitudes).real
        return response

    def offset_mm(self, sample: Sample) -> FloatArray:
        """By how much (2,) a node's print lies off the series: F(x + offset) fits its light best."""
        dimming = _dimming(self.lattice, sample.metric[None], self.blur_px)
        waves = self.lattice.waves(sample.mm) * dimming * self.amplitudes
        gradient = (1j * waves @ self.lattice.vectors).real
        rest = sample.ratio - self.mean - waves.sum(axis=1).real
        weighted = gradient * sample.weight[:, None]
        return np.asarray(np.linalg.solve(weighted.T @ gradient, weighted.T @ rest))


def _dimming(lattice: Lattice, metrics: FloatArray, blur_px: float) -> FloatArray:
    """By how much a Gaussian blur weakens each harmonic, (places, harmonics), at metrics (places, 2, 2)."""
    x, y = lattice.vectors.T
    squared = (
        metrics[:, 0, 0, None] * x * x + 2 * metrics[:, 0, 1, None] * x * y + metrics[:, 1, 1, None] * y * y
    )
    weaker: FloatArray = np.exp(-0.5 * blur_px**2 * np.minimum(squared, _MOST_WEAKENED))
    return weaker
