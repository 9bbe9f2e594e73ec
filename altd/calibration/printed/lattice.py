"""The lattice on which a print's dots lie, from the spectra of what the spots of a scan show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from altd.calibration.printed.sample import Sample
from altd.records import ComplexArray, FloatArray

_LEAST_RADIANS_PER_MM, _MOST_RADIANS_PER_MM = 1.5, 13.0
"""Hexagonal prints of 4.8 mm pitch down to 0.56 mm, square ones of 4.2 down to 0.48 mm."""
_STEP_RADIANS_PER_MM = 0.12
_LEAST_SINE = 0.6
"""Of the angle between the two vectors."""
_SEARCHED_NODES = 12

_FIRST_NODES = 3
_FEW_NODES = 8
_WIDE_TURN, _NARROW_TURN = 0.06, 0.012
"""Radians per mm: half a step of the spectra at first, then what a few nodes leave open."""
_TURNS = 31
_REFINEMENTS = 5
_LEAST_COHERENCE = 0.8

_ORDER = 5
_HEXAGON = np.sqrt(3) / 2
"""Area of a hexagonal lattice's cell whose side is 1."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """A regular print: ``reciprocal`` (2, 2) radians per mm, one vector a row, any two that span it."""

    reciprocal: FloatArray

    @property
    def pitch_mm(self) -> float:
        """The shortest step from dot to dot."""
        a, b = 2 * np.pi * np.linalg.inv(self.reciprocal).T
        return min(float(np.hypot(*(h * a + k * b))) for h, k in ((1, 0), (0, 1), (1, 1), (1, -1)))

    @cached_property
    def harmonics(self) -> npt.NDArray[np.int_]:
        """(harmonics, 2): h, k of one half of the reciprocal lattice's points around the middle.

        Those within a circle that holds the fifth ring of a hexagonal lattice: as many whatever the lattice.
        """
        span = np.arange(-2 * _ORDER, 2 * _ORDER + 1)
        h, k = (grid.ravel() for grid in np.meshgrid(span, span, indexing="ij"))
        squared = np.square(np.stack([h, k], axis=1) @ self.reciprocal).sum(axis=1)
        area = abs(float(np.linalg.det(self.reciprocal)))
        kept = (squared < 1.01 * _ORDER**2 * area / _HEXAGON) & ((h > 0) | ((h == 0) & (k > 0)))
        return np.stack([h[kept], k[kept]], axis=1)

    @cached_property
    def vectors(self) -> FloatArray:
        """The harmonics (harmonics, 2) in radians per mm."""
        vectors: FloatArray = self.harmonics @ self.reciprocal
        return vectors

    def waves(self, mm: FloatArray) -> ComplexArray:
        """exp(i (h b₁ + k b₂)·x) at points (n, 2), (n, harmonics), by multiplication."""
        highest = int(np.abs(self.harmonics).max())
        powers = np.empty((2, 2 * highest + 1, len(mm)), np.complex128)
        for wave, of_wave in zip(np.exp(1j * (mm @ self.reciprocal.T)).T, powers, strict=True):
            of_wave[highest] = 1
            for n in range(1, highest + 1):
                of_wave[highest + n] = of_wave[highest + n - 1] * wave
            of_wave[:highest] = of_wave[:highest:-1].conj()
        h, k = self.harmonics.T
        waves: ComplexArray = (powers[0, highest + h] * powers[1, highest + k]).T
        return waves


def find_lattice(samples: Sequence[Sample], centres_mm: FloatArray) -> Lattice | None:
    """The two strongest reciprocal vectors, if all nodes, at centres (n, 2), agree on them; else None.

    First in the inner nodes' spectra, then coherently from the middle outwards. Waves that move with the spot
    belong to the beam (fringes, the shape of its profile) and are no print.
    """
    outwards = np.argsort(np.hypot(*(centres_mm - centres_mm.mean(axis=0)).T))
    samples, centres_mm = [samples[index] for index in outwards], centres_mm[outwards]
    vectors = []
    for rough in _strongest_two(samples[:_SEARCHED_NODES]):
        vector = _cohere(rough, samples, centres_mm)
        if vector is None:
            return None
        vectors.append(vector)
    return Lattice(np.array(_shortest(*vectors)))


def _strongest_two(samples: Sequence[Sample]) -> tuple[FloatArray, FloatArray]:
    """The strongest wave of the summed spectra, and the strongest that runs another way."""
    along_x = np.arange(-_MOST_RADIANS_PER_MM, _MOST_RADIANS_PER_MM + 1e-9, _STEP_RADIANS_PER_MM)
    along_y = along_x[along_x > -1e-9]
    power = np.sum([np.abs(_spectrum(sample, along_x, along_y)) ** 2 for sample in samples], axis=0)
    x, y = np.meshgrid(along_x, along_y)
    length = np.hypot(x, y)
    power[(length < _LEAST_RADIANS_PER_MM) | (length > _MOST_RADIANS_PER_MM)] = 0
    first = _at_peak(power, x, y)
    sine = (x * first[1] - y * first[0]) / np.maximum(length * np.hypot(*first), 1e-9)
    return first, _at_peak(np.where(np.abs(sine) > _LEAST_SINE, power, 0), x, y)


def _spectrum(sample: Sample, along_x: FloatArray, along_y: FloatArray) -> ComplexArray:
    x, y = (sample.mm - sample.mm.mean(axis=0)).T
    light = _deviation(sample)
    return np.asarray((np.exp(-1j * np.outer(along_y, y)) * light) @ np.exp(-1j * np.outer(x, along_x)))


def _at_peak(power: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    peak = np.unravel_index(int(power.argmax()), power.shape)
    return np.array([x[peak], y[peak]])


def _cohere(vector: FloatArray, samples: Sequence[Sample], centres_mm: FloatArray) -> FloatArray | None:
    """Turn and stretch a reciprocal vector until all nodes agree on its phase, from the first ones on."""
    for count in range(min(_FIRST_NODES, len(samples)), len(samples) + 1):
        widest = _WIDE_TURN if count < _FEW_NODES else _NARROW_TURN
        turns = np.linspace(-widest, widest, _TURNS)
        phasors = np.array([_phasor(sample, vector) for sample in samples[:count]])
        turn_x, turn_y = np.meshgrid(turns, turns)
        x, y = centres_mm[:count].T
        sums = np.abs(np.exp(-1j * (turn_x[..., None] * x + turn_y[..., None] * y)) @ phasors)
        best = np.unravel_index(int(sums.argmax()), sums.shape)
        vector = vector + np.array([turn_x[best], turn_y[best]])
    design = np.column_stack([np.ones(len(samples)), centres_mm])
    for _ in range(_REFINEMENTS):
        phasors = np.array([_phasor(sample, vector) for sample in samples])
        vector = vector + np.linalg.lstsq(design, np.angle(phasors / phasors.mean()), rcond=None)[0][1:]
    with_the_spot = phasors * np.exp(1j * (centres_mm @ vector))
    if abs(phasors.mean()) < _LEAST_COHERENCE or abs(with_the_spot.mean()) > _LEAST_COHERENCE:
        return None
    return vector


def _phasor(sample: Sample, vector: FloatArray) -> complex:
    """The phase of one wave in a sample, as a number of length 1."""
    total = np.sum(_deviation(sample) * np.exp(-1j * (sample.mm @ vector)))
    return complex(total / max(abs(total), 1e-12))


def _deviation(sample: Sample) -> FloatArray:
    deviation: FloatArray = (sample.ratio - np.average(sample.ratio, weights=sample.weight)) * sample.weight
    return deviation


def _shortest(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The shortest two vectors that span the same lattice (Lagrange and Gauss)."""
    while True:
        if a @ a > b @ b:
            a, b = b, a
        steps = round(float(a @ b) / float(a @ a))
        if steps == 0:
            return a, b
        b = b - steps * a
