"""How much light each place of a print sends to the camera: a Fourier series on its lattice."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from altd.calibration.printed.lattice import Lattice
from altd.calibration.printed.sample import Sample
from altd.records import ComplexArray, FloatArray

_RIDGE = 1e-6
_MAX_WEAKENING = 40.0
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
    def fit(cls, lattice: Lattice, samples: Iterable[Sample], blurs_px: Sequence[float]) -> Series:
        """Weighted least squares through all samples; of some blurs the one that fits best.

        Gone through once, by normal equations that are summed up sample after sample. One blur weakens a
        harmonic alike in all of a sample, so a sample's equations without blur, scaled, are those of each
        blur.
        """
        half = len(lattice.vectors)
        sums = [_Sums.empty(1 + 2 * half) for _ in blurs_px]
        for sample in samples:
            plain = _Sums.empty(1 + 2 * half)
            for part in sample.parts():
                plain.add(part, lattice.waves(part.mm))
            for of_blur, blur_px in zip(sums, blurs_px, strict=True):
                dimming = _dimming(lattice, sample.metric[None], blur_px)[0]
                of_blur.add_scaled(plain, np.concatenate([[1.0], dimming, dimming]))
        fits = []
        for of_blur, blur_px in zip(sums, blurs_px, strict=True):
            solution, cost = of_blur.solved()
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
        amplitudes = _dimming(self.lattice, sample.metric[None], self.blur_px) * self.amplitudes
        normal, right = np.zeros((2, 2)), np.zeros(2)
        for part in sample.parts():
            waves = self.lattice.waves(part.mm) * amplitudes
            gradient = (1j * waves @ self.lattice.vectors).real
            rest = part.ratio - self.mean - waves.sum(axis=1).real
            weighted = gradient * part.weight[:, None]
            normal += weighted.T @ gradient
            right += weighted.T @ rest
        return np.asarray(np.linalg.solve(normal, right))


@dataclass(slots=True, eq=False)
class _Sums:
    """Normal equations of least squares: their matrix (p, p), right-hand side (p,) and Σ weight · ratio².

    They square the condition, which does no harm here: the waves of a lattice are nearly orthogonal over the
    pixels of a scan, so the matrix, scaled to a diagonal of 1, has a condition of 1.0 to 1.2
    (docs/decisions/0029-memory.md). Unscaled it has up to 10¹³: a blur leaves next to nothing of the highest
    harmonics.
    """

    normal: FloatArray
    right: FloatArray
    square: float

    @classmethod
    def empty(cls, size: int) -> _Sums:
        """Of nothing yet."""
        return cls(np.zeros((size, size)), np.zeros(size), 0.0)

    def add(self, sample: Sample, waves: ComplexArray) -> None:
        """Take in the pixels of a sample, at which the waves are (n, harmonics)."""
        design = np.column_stack([np.ones(len(waves)), waves.real, -waves.imag])
        weighted = design * sample.weight[:, None]
        self.normal += weighted.T @ design
        self.right += weighted.T @ sample.ratio
        self.square += float(sample.weight @ np.square(sample.ratio))

    def add_scaled(self, other: _Sums, scale: FloatArray) -> None:
        """Take in what others have summed up, its columns times ``scale`` (p,)."""
        self.normal += other.normal * scale * scale[:, None]
        self.right += other.right * scale
        self.square += other.square

    def solved(self) -> tuple[FloatArray, float]:
        """The solution (p,), and what it leaves over: Σ weight · rest²."""
        ridged = self.normal + _RIDGE * np.eye(len(self.right))
        scale = 1 / np.sqrt(ridged.diagonal())
        solution = scale * np.linalg.solve(ridged * scale * scale[:, None], self.right * scale)
        return np.asarray(solution), self.square - float(solution @ (2 * self.right - self.normal @ solution))


def _dimming(lattice: Lattice, metrics: FloatArray, blur_px: float) -> FloatArray:
    """By how much a Gaussian blur weakens each harmonic, (places, harmonics), at metrics (places, 2, 2)."""
    x, y = lattice.vectors.T
    squared = (
        metrics[:, 0, 0, None] * x * x + 2 * metrics[:, 0, 1, None] * x * y + metrics[:, 1, 1, None] * y * y
    )
    weaker: FloatArray = np.exp(-0.5 * blur_px**2 * np.minimum(squared, _MAX_WEAKENING))
    return weaker
