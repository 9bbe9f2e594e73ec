"""The lattice of a print's dots, from the spectra of the ground under the spots of a scan."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import numpy.typing as npt

from altd.calibration.printed.sample import NodePixels
from altd.records import ComplexArray, FloatArray

_MIN_RADIANS_PER_MM, _MAX_RADIANS_PER_MM = 1.5, 13.0
"""Search range: hexagonal prints of 4.8 mm pitch down to 0.56 mm, square ones of 4.2 down to 0.48 mm."""
_STEP_RADIANS_PER_MM = 0.12
_MIN_SINE = 0.6
"""Minimum sine of the angle between the two vectors."""
_SPECTRUM_NODES = 12

_MIN_NODES_AT_ONCE = 3
_MIN_NODES_FOR_NARROW = 8
_WIDE_TURN, _NARROW_TURN = 0.06, 0.012
"""Search ranges, radians per mm: half a step of the spectra, then the uncertainty after a few nodes."""
_TURNS = 31
_KNOWN_PER_NEW = 64
"""Number of known nodes per node added at a time: the first 127 are added one by one."""
_REFINEMENTS = 5
_MOMENTS = 6
_MIN_COHERENCE = 0.8

_ORDER = 5
_HEXAGONAL_CELL = np.sqrt(3) / 2
"""Area of a hexagonal lattice's cell whose side is 1."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """A regular print: ``reciprocal`` (2, 2), any two vectors that span it, one per row, radians per mm."""

    reciprocal: FloatArray

    @property
    def pitch_mm(self) -> float:
        """Shortest distance between dots."""
        a, b = 2 * np.pi * np.linalg.inv(self.reciprocal).T
        return min(float(np.hypot(*(h * a + k * b))) for h, k in ((1, 0), (0, 1), (1, 1), (1, -1)))

    @cached_property
    def harmonics(self) -> npt.NDArray[np.int_]:
        """Indices h, k (harmonics, 2) of one half of the reciprocal lattice's points around the middle.

        They are within a circle that holds the fifth ring of a hexagonal lattice, scaled to the cell's area,
        so their number hardly depends on the lattice.
        """
        span = np.arange(-2 * _ORDER, 2 * _ORDER + 1)
        h, k = (grid.ravel() for grid in np.meshgrid(span, span, indexing="ij"))
        squared = np.square(np.stack([h, k], axis=1) @ self.reciprocal).sum(axis=1)
        area = abs(float(np.linalg.det(self.reciprocal)))
        kept = (squared < 1.01 * _ORDER**2 * area / _HEXAGONAL_CELL) & ((h > 0) | ((h == 0) & (k > 0)))
        return np.stack([h[kept], k[kept]], axis=1)

    @cached_property
    def vectors(self) -> FloatArray:
        """The harmonics (harmonics, 2) in radians per mm."""
        vectors: FloatArray = self.harmonics @ self.reciprocal
        return vectors

    def waves(self, mm: FloatArray) -> ComplexArray:
        """Compute exp(i (h b₁ + k b₂)·x) at points (n, 2), (n, harmonics), by multiplication."""
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


class Samples(Protocol):
    """Samples of some nodes, by number; an access may take as long as the analysis of a frame."""

    def __len__(self) -> int: ...

    def __getitem__(self, at: int, /) -> NodePixels: ...


def find_lattice(samples: Samples, centres_mm: FloatArray) -> Lattice | None:
    """Find the two strongest reciprocal vectors; None unless all nodes, at centres (n, 2), agree on them.

    The inner nodes' spectra give a first estimate, refined coherently from the middle outwards. Waves that
    move with the spot belong to the beam (fringes, the shape of its profile) and are no print.
    """
    outwards = np.argsort(np.hypot(*(centres_mm - centres_mm.mean(axis=0)).T))
    inner = [samples[index] for index in outwards[:_SPECTRUM_NODES].tolist()]
    rough = np.array(_strongest_two(inner))
    propagated = _propagated(rough, (samples[index] for index in outwards.tolist()), centres_mm[outwards])
    moments = np.empty((2, len(samples), _MOMENTS), np.complex128)
    for node, centre_mm in enumerate(centres_mm):
        sample = samples[node]
        moments[:, node] = [_moments(sample, vector, centre_mm) for vector in propagated]
    vectors = [_refined(*of_wave, centres_mm) for of_wave in zip(propagated, moments, strict=True)]
    found = [vector for vector in vectors if vector is not None]
    return Lattice(np.array(_shortest(*found))) if len(found) == 2 else None


def _strongest_two(samples: Sequence[NodePixels]) -> tuple[FloatArray, FloatArray]:
    """Find the strongest wave of the summed spectra, and the strongest one in another direction."""
    along_x = np.arange(-_MAX_RADIANS_PER_MM, _MAX_RADIANS_PER_MM + 1e-9, _STEP_RADIANS_PER_MM)
    along_y = along_x[along_x > -1e-9]
    power = np.sum([np.abs(_spectrum(sample, along_x, along_y)) ** 2 for sample in samples], axis=0)
    x, y = np.meshgrid(along_x, along_y)
    length = np.hypot(x, y)
    power[(length < _MIN_RADIANS_PER_MM) | (length > _MAX_RADIANS_PER_MM)] = 0
    first = _at_peak(power, x, y)
    sine = (x * first[1] - y * first[0]) / np.maximum(length * np.hypot(*first), 1e-9)
    return first, _at_peak(np.where(np.abs(sine) > _MIN_SINE, power, 0), x, y)


def _spectrum(sample: NodePixels, along_x: FloatArray, along_y: FloatArray) -> ComplexArray:
    x, y = (sample.mm - sample.mm.mean(axis=0)).T
    light = _deviation(sample)
    return np.asarray((np.exp(-1j * np.outer(along_y, y)) * light) @ np.exp(-1j * np.outer(x, along_x)))


def _at_peak(power: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    peak = np.unravel_index(int(power.argmax()), power.shape)
    return np.array([x[peak], y[peak]])


def _propagated(vectors: FloatArray, samples: Iterable[NodePixels], centres_mm: FloatArray) -> FloatArray:
    """Turn and stretch reciprocal vectors (2, 2) until the nodes agree on their phases.

    Nodes are added from the middle outwards, the more are known the more at a time: linear in their number.
    A node's phases are measured once and then turned like its centre's, sufficient for a first estimate.
    """
    vectors, coming = vectors.copy(), iter(samples)
    phasors = np.zeros((2, len(centres_mm)), np.complex128)
    known = 0
    while known < len(centres_mm):
        count = min(max(_MIN_NODES_AT_ONCE, known + 1, known + known // _KNOWN_PER_NEW), len(centres_mm))
        for node in range(known, count):
            sample = next(coming)
            phasors[:, node] = [_phasor(sample, vector) for vector in vectors]
        known = count
        turns = np.linspace(-1, 1, _TURNS) * (_WIDE_TURN if count < _MIN_NODES_FOR_NARROW else _NARROW_TURN)
        by_x, by_y = np.exp(-1j * turns[:, None, None] * centres_mm[:count].T).transpose(1, 0, 2)
        for vector, of_wave in zip(vectors, phasors, strict=True):
            sums = np.abs((by_y * of_wave[:count]) @ by_x.T)
            y, x = np.unravel_index(int(sums.argmax()), sums.shape)
            vector += turns[[x, y]]
            of_wave[:count] *= by_x[x] * by_y[y]
    return vectors


def _moments(sample: NodePixels, vector: FloatArray, centre_mm: FloatArray) -> ComplexArray:
    """Sum of a wave over a sample, and its moments about the node's centre: sum, x, y, xx, xy, yy."""
    x, y = (sample.mm - centre_mm).T
    light = _deviation(sample) * np.exp(-1j * (sample.mm @ vector))
    return np.asarray(np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y]) @ light)


def _turned(moments: ComplexArray, centres_mm: FloatArray, turn: FloatArray) -> ComplexArray:
    """Phases (n,) of nodes whose wave is turned slightly, as numbers of length 1.

    Second order in ``turn``: for a thousandth of a radian per mm, accurate to 1e-7 at 10 mm.
    """
    x, y = turn
    all_, by_x, by_y, xx, xy, yy = moments.T
    total = all_ - 1j * (x * by_x + y * by_y) - (x * x / 2 * xx + x * y * xy + y * y / 2 * yy)
    total = total * np.exp(-1j * (centres_mm @ turn))
    return np.asarray(total / np.maximum(np.abs(total), 1e-12))


def _refined(vector: FloatArray, moments: ComplexArray, centres_mm: FloatArray) -> FloatArray | None:
    """Turn and stretch a reciprocal vector by the remaining phases of all nodes; None if they disagree.

    ``moments`` (n, 6) are the moments of the samples with this vector, ``centres_mm`` (n, 2) the nodes.
    """
    design = np.column_stack([np.ones(len(centres_mm)), centres_mm])
    turn = np.zeros(2)
    for _ in range(_REFINEMENTS):
        phasors = _turned(moments, centres_mm, turn)
        turn = turn + np.linalg.lstsq(design, np.angle(phasors / phasors.mean()), rcond=None)[0][1:]
    with_the_spot = phasors * np.exp(1j * (centres_mm @ (vector + turn)))
    if abs(phasors.mean()) < _MIN_COHERENCE or abs(with_the_spot.mean()) > _MIN_COHERENCE:
        return None
    return np.asarray(vector + turn)


def _phasor(sample: NodePixels, vector: FloatArray) -> complex:
    """Phase of one wave in a sample, as a number of length 1."""
    total = np.sum(_deviation(sample) * np.exp(-1j * (sample.mm @ vector)))
    return complex(total / max(abs(total), 1e-12))


def _deviation(sample: NodePixels) -> FloatArray:
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
