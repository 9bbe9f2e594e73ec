"""The print of a target, found from the frames of its own scan, where no flat was recorded.

Printed dots are a lattice: two reciprocal vectors and a Fourier series say how much light each place sends
to the camera. The lattice is regular in the plane of the print, so it also tells where the map bends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from altd.mapping.marks import Marks
from altd.mapping.tensor_map import TensorMap
from altd.records import ComplexArray, FloatArray, Frame, NoSpot
from altd.vision.background import pixel_noise
from altd.vision.centre import Noise
from altd.vision.flat import Flat
from altd.vision.patch import Mask, patch_around
from altd.vision.profile import fit_profile
from altd.vision.search import search
from altd.vision.settings import SpotSettings

_LEAST_CONTRAST = 0.35
_GRAIN = 0.15
"""Relative scatter that a pixel keeps beside the print: limits the weight of bright pixels."""
_SHARE_OF_PEAK = 0.15
_LEAST_RADIANS_PER_MM, _MOST_RADIANS_PER_MM = 1.5, 13.0
"""Pitches from 4.8 mm down to 0.56 mm."""
_STEP_RADIANS_PER_MM = 0.12
_SEARCHED_NODES = 12
_LEAST_COHERENCE = 0.8
_ORDER = 5
_BLURS_PX = 0.3, 0.5, 0.7, 0.9, 1.1
_ROUNDS = 3
_LEAST_MARK_SIGMA_MM = 0.002
"""Print is no more regular than that, nor is a node's spread of dots over a bent picture."""
_MARGIN_MM = 8.0
_PLANE_DEGREE = 8


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """A regular print: ``reciprocal`` (2, 2) radians per mm, one vector a row."""

    reciprocal: FloatArray

    @property
    def pitches_mm(self) -> tuple[float, float]:
        """Lengths of the two shortest steps from dot to dot."""
        steps = 2 * np.pi * np.linalg.inv(self.reciprocal)
        a, b = steps[:, 0], steps[:, 1]
        lengths = sorted(float(np.hypot(*step)) for step in (a, b, a + b, a - b))
        return lengths[0], lengths[1]


@dataclass(frozen=True, slots=True, eq=False)
class Print:
    """What the scan shows of a print.

    ``marks`` are the print's own regular coordinates at the nodes.
    """

    lattice: Lattice
    flat: Flat
    marks: Marks


@dataclass(frozen=True, slots=True, eq=False)
class _Sample:
    """The lit pixels of one node: places mm, light relative to the even spot, weights; mm² per px² there."""

    mm: FloatArray
    ratio: FloatArray
    weight: FloatArray
    metric: FloatArray


def find_print(
    nodes: Sequence[Frame], nodes_px: FloatArray, first_map: TensorMap, settings: SpotSettings
) -> Print | None:
    """The print that the spots at a scan's nodes show; None when there is none or it is not regular.

    ``nodes`` holds one exposure of each node, ``nodes_px`` (n, 2) where the spots are, ``first_map`` a map
    that is good to a tenth of a dot pitch.
    """
    plane = _Plane(first_map)
    samples = [_sample(frame, plane, settings, None) for frame in nodes]
    ratio = np.concatenate([sample.ratio for sample in samples])
    if not len(ratio) or float(ratio.std()) < _LEAST_CONTRAST * float(ratio.mean()):
        return None
    lattice = _find_lattice(samples, nodes_px, plane)
    if lattice is None:
        return None
    rows, columns = nodes[0].pixels.shape
    centres_mm = plane.to_mm(nodes_px)
    correction = np.zeros((_CUBIC, 2))
    series, moved, flat = None, centres_mm, None
    for round_ in range(_ROUNDS):
        if round_ > 0:
            samples = [_sample(frame, plane, settings, flat) for frame in nodes]
        regular = [replace(sample, mm=sample.mm + _smooth(sample.mm, correction)) for sample in samples]
        series = _Series.fit(lattice, regular, _BLURS_PX if series is None else (series.blur_px,))
        offsets = np.array([series.offset_mm(sample) for sample in regular])
        moved = _smooth(centres_mm, correction) + offsets
        correction = np.asarray(np.linalg.lstsq(_cubic(centres_mm), moved, rcond=None)[0])
        flat = _render(series, plane, correction, rows, columns)
    assert flat is not None  # noqa: S101  there are rounds
    left_over = moved - _smooth(centres_mm, correction)
    sigma_mm = float(np.sqrt(np.square(left_over).sum() / max(2 * len(nodes) - 2 * _CUBIC, 1)))
    return Print(lattice, flat, Marks(nodes_px, centres_mm + moved, max(sigma_mm, _LEAST_MARK_SIGMA_MM)))


class _Plane:
    """The inverse of a map as one polynomial, quick for many pixels; good to nanometres inside the hull."""

    def __init__(self, fitted: TensorMap) -> None:
        x, y = (
            np.linspace(axis.first_mm - _MARGIN_MM, axis.last_mm + _MARGIN_MM, 50)
            for axis in (fitted.x_axis, fitted.y_axis)
        )
        mm = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        px = fitted.to_px(mm)
        self._middle = px.mean(axis=0)
        self._scale = float(np.abs(px - self._middle).max())
        u, v = self._powers(px[:, 0], 0), self._powers(px[:, 1], 1)
        i, j = np.nonzero(
            np.add.outer(np.arange(_PLANE_DEGREE + 1), np.arange(_PLANE_DEGREE + 1)) <= _PLANE_DEGREE
        )
        self._coefficients = np.zeros((2, _PLANE_DEGREE + 1, _PLANE_DEGREE + 1))
        self._coefficients[:, i, j] = np.linalg.lstsq(u[:, i] * v[:, j], mm, rcond=None)[0].T

    def to_mm(self, px: FloatArray) -> FloatArray:
        """Points (n, 2) px as (n, 2) mm."""
        u, v = self._powers(px[:, 0], 0), self._powers(px[:, 1], 1)
        return np.stack([((u @ coefficients) * v).sum(axis=1) for coefficients in self._coefficients], axis=1)

    def grid_mm(self, rows: int, columns: int) -> FloatArray:
        """All pixels of a picture as (rows, columns, 2) mm."""
        u = self._powers(np.arange(columns, dtype=np.float64), 0)
        v = self._powers(np.arange(rows, dtype=np.float64), 1)
        return np.stack([v @ coefficients.T @ u.T for coefficients in self._coefficients], axis=-1)

    def metric(self, px: FloatArray) -> FloatArray:
        """J Jᵀ (2, 2) at a point (2,) px, with J = d(mm)/d(px)."""
        ends = self.to_mm(px + 0.5 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]))
        jacobian = np.column_stack([ends[0] - ends[1], ends[2] - ends[3]])
        return np.asarray(jacobian @ jacobian.T)

    def _powers(self, px: FloatArray, axis: int) -> FloatArray:
        return np.vander((px - self._middle[axis]) / self._scale, _PLANE_DEGREE + 1, increasing=True)


def _sample(frame: Frame, plane: _Plane, settings: SpotSettings, flat: Flat | None) -> _Sample:
    """Without a flat the light is taken relative to the smoothed spot, with one to the fitted profile."""
    nothing = _Sample(np.empty((0, 2)), np.empty(0), np.empty(0), np.eye(2))
    found = search(frame.pixels)
    patch = patch_around(frame, found.regions[0], found, settings) if found.regions else None
    if patch is None or isinstance(patch, NoSpot):
        return nothing
    noise = Noise(
        pixel_noise(frame.pixels, found.background), settings.full_well_electrons / frame.full_scale
    )
    height, width = patch.excess.shape
    u = np.arange(patch.left, patch.left + width, dtype=np.float64)
    v = np.arange(patch.top, patch.top + height, dtype=np.float64)
    light, even = patch.excess.astype(np.float64), patch.smooth.astype(np.float64)
    if flat is not None:
        profile = fit_profile(patch, flat, _diameter_px(patch.mask), noise)
        if profile is None:
            return nothing
        light, even = light - profile.rest, profile.irradiance(u, v)
    lit = even > _SHARE_OF_PEAK * even.max()
    relative = (noise.read_counts**2 + even[lit] / noise.electrons_per_count) / even[lit] ** 2
    grid = np.stack(np.meshgrid(u, v), axis=-1)[lit]
    return _Sample(
        plane.to_mm(grid), light[lit] / even[lit], 1 / (_GRAIN**2 + relative), plane.metric(grid.mean(axis=0))
    )


def _diameter_px(mask: Mask) -> float:
    return float(np.sqrt(np.count_nonzero(mask) * 4 / np.pi))


def _find_lattice(samples: Sequence[_Sample], nodes_px: FloatArray, plane: _Plane) -> Lattice | None:
    """The two strongest reciprocal vectors: in the inner nodes' spectra, then coherently over all nodes."""
    steps = np.arange(-_MOST_RADIANS_PER_MM, _MOST_RADIANS_PER_MM + 1e-9, _STEP_RADIANS_PER_MM)
    half = steps[steps > -1e-9]
    power = np.zeros((len(half), len(steps)))
    centres = plane.to_mm(nodes_px)
    inner = np.argsort(np.hypot(*(centres - centres.mean(axis=0)).T))[:_SEARCHED_NODES]
    for index in inner:
        power += np.abs(_transform(samples[index], steps, half)) ** 2
    length = np.hypot(*np.meshgrid(steps, half))
    power[(length < _LEAST_RADIANS_PER_MM) | (length > _MOST_RADIANS_PER_MM)] = 0
    first = _strongest(power, steps, half)
    angle = np.arctan2(*np.meshgrid(half, steps, indexing="ij"))
    apart = np.abs(np.sin(angle - np.arctan2(first[1], first[0])))
    second = _strongest(np.where(apart > 0.6, power, 0), steps, half)
    vectors = [_cohere(np.array(vector), samples, centres) for vector in (first, second)]
    if any(vector is None for vector in vectors):
        return None
    return Lattice(np.array(vectors))


def _transform(sample: _Sample, along_x: FloatArray, along_y: FloatArray) -> ComplexArray:
    middle = sample.mm.mean(axis=0)
    x, y = (sample.mm - middle).T
    mean = np.average(sample.ratio, weights=sample.weight)
    light = (sample.ratio - mean) * sample.weight
    return np.asarray((np.exp(-1j * np.outer(along_y, y)) * light) @ np.exp(-1j * np.outer(x, along_x)))


def _strongest(power: FloatArray, along_x: FloatArray, along_y: FloatArray) -> tuple[float, float]:
    row, column = np.unravel_index(int(power.argmax()), power.shape)
    return float(along_x[column]), float(along_y[row])


def _cohere(vector: FloatArray, samples: Sequence[_Sample], centres: FloatArray) -> FloatArray | None:
    """Turn and stretch a reciprocal vector until all nodes agree on its phase, from the middle outwards."""
    order = np.argsort(np.hypot(*(centres - centres.mean(axis=0)).T))
    for count in range(3, len(samples) + 1):
        wide = 0.06 if count < 8 else 0.012
        steps = np.linspace(-wide, wide, 31)
        phases = np.array([_phasor(samples[index], vector) for index in order[:count]])
        turn_x, turn_y = np.meshgrid(steps, steps)
        at = centres[order[:count]]
        sums = np.abs(np.exp(-1j * (turn_x[..., None] * at[:, 0] + turn_y[..., None] * at[:, 1])) @ phases)
        best = np.unravel_index(int(sums.argmax()), sums.shape)
        vector = vector + np.array([turn_x[best], turn_y[best]])
    design = np.column_stack([np.ones(len(samples)), centres])
    for _ in range(5):
        phases = np.array([_phasor(sample, vector) for sample in samples])
        mean = phases.mean()
        vector = vector + np.linalg.lstsq(design, np.angle(phases / mean), rcond=None)[0][1:]
    return vector if abs(mean) > _LEAST_COHERENCE else None


def _phasor(sample: _Sample, vector: FloatArray) -> complex:
    mean = np.average(sample.ratio, weights=sample.weight)
    total = np.sum((sample.ratio - mean) * sample.weight * np.exp(-1j * (sample.mm @ vector)))
    return complex(total / max(abs(total), 1e-12))


def _harmonics() -> list[tuple[int, int]]:
    """(h, k) of half the plane up to the order, hexagonal distance."""
    span = range(-_ORDER, _ORDER + 1)
    return [
        (h, k)
        for h in span
        for k in span
        if (h > 0 or (h == 0 and k > 0)) and max(abs(h), abs(k), abs(h + k)) <= _ORDER
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Series:
    """F over the print's plane as a Fourier series on the lattice: mean, then a complex number a harmonic.

    Lens and pixel blur the picture alike everywhere, ``blur_px``, so where the picture of the print is small
    its harmonics are weaker; the amplitudes are those of the print itself.
    """

    lattice: Lattice
    mean: float
    amplitudes: ComplexArray
    blur_px: float

    @classmethod
    def fit(cls, lattice: Lattice, samples: Sequence[_Sample], blurs_px: Sequence[float]) -> _Series:
        """Weighted least squares through all samples; of some blurs the one that fits best."""
        mm = np.concatenate([sample.mm for sample in samples])
        ratio = np.concatenate([sample.ratio for sample in samples])
        weight = np.concatenate([sample.weight for sample in samples])
        counts = [len(sample.mm) for sample in samples]
        metrics = np.array([sample.metric for sample in samples])
        waves = _waves(lattice, mm)
        best: tuple[float, _Series] | None = None
        for blur_px in blurs_px:
            dimming = np.repeat(_dimming(lattice, metrics, blur_px), counts, axis=0)
            blurred = waves * dimming
            design = np.column_stack([np.ones(len(mm)), blurred.real, -blurred.imag])
            weighted = design * weight[:, None]
            normal = weighted.T @ design + 1e-6 * np.eye(design.shape[1])
            solution = np.linalg.solve(normal, weighted.T @ ratio)
            cost = float(weight @ np.square(ratio - design @ solution))
            half = waves.shape[1]
            series = cls(
                lattice, float(solution[0]), solution[1 : 1 + half] + 1j * solution[1 + half :], blur_px
            )
            if best is None or cost < best[0]:
                best = cost, series
        assert best is not None  # noqa: S101  there are blurs
        return best[1]

    def at(self, mm: FloatArray, metrics: FloatArray) -> FloatArray:
        """F at points (n, 2) mm with their metrics (n, 2, 2)."""
        waves = _waves(self.lattice, mm)
        waves *= _dimming(self.lattice, metrics, self.blur_px)
        response: FloatArray = self.mean + (waves @ self.amplitudes).real
        return response

    def offset_mm(self, sample: _Sample) -> FloatArray:
        """By how much (2,) a node's print lies off the series: F(x + offset) fits its light best."""
        dimming = _dimming(self.lattice, sample.metric[None], self.blur_px)
        waves = _waves(self.lattice, sample.mm) * dimming * self.amplitudes
        vectors = np.array(_harmonics()) @ self.lattice.reciprocal
        gradient = (1j * waves @ vectors).real
        rest = sample.ratio - self.mean - waves.sum(axis=1).real
        weighted = gradient * sample.weight[:, None]
        return np.asarray(np.linalg.solve(weighted.T @ gradient, weighted.T @ rest))


def _dimming(lattice: Lattice, metrics: FloatArray, blur_px: float) -> FloatArray:
    """By how much a Gaussian blur weakens each harmonic, (places, harmonics), at metrics (places, 2, 2)."""
    x, y = (np.array(_harmonics()) @ lattice.reciprocal).T
    squared = (
        metrics[:, 0, 0, None] * x * x + 2 * metrics[:, 0, 1, None] * x * y + metrics[:, 1, 1, None] * y * y
    )
    # the strongest blurs take the highest harmonics below what numbers can undo
    weaker: FloatArray = np.exp(-0.5 * blur_px**2 * np.minimum(squared, 40.0))
    return weaker


def _waves(lattice: Lattice, mm: FloatArray) -> ComplexArray:
    """exp(i (h b₁ + k b₂)·x), (points, harmonics), by multiplication."""
    turns = np.exp(1j * (mm @ lattice.reciprocal.T)).T
    powers = np.empty((2, 2 * _ORDER + 1, len(mm)), np.complex128)
    for wave, of_wave in zip(turns, powers, strict=True):
        of_wave[_ORDER] = 1
        for n in range(1, _ORDER + 1):
            of_wave[_ORDER + n] = of_wave[_ORDER + n - 1] * wave
        of_wave[:_ORDER] = of_wave[:_ORDER:-1].conj()
    h, k = np.array(_harmonics()).T
    waves: ComplexArray = (powers[0, _ORDER + h] * powers[1, _ORDER + k]).T
    return waves


_CUBIC = 10


def _cubic(mm: FloatArray) -> FloatArray:
    x, y = mm.T / 50.0
    xx, yy = x * x, y * y
    return np.stack([np.ones(len(x)), x, y, xx, x * y, yy, xx * x, xx * y, x * yy, yy * y], axis=1)


def _smooth(places_mm: FloatArray, coefficients: FloatArray) -> FloatArray:
    """The cubic field with coefficients (10, 2) at places (n, 2)."""
    field: FloatArray = _cubic(places_mm) @ coefficients
    return field


def _render(series: _Series, plane: _Plane, correction: FloatArray, rows: int, columns: int) -> Flat:
    """F at every pixel of the picture, mean 1."""
    mm = plane.grid_mm(rows, columns)
    by_v, by_u = (np.asarray(slope) for slope in np.gradient(mm, axis=(0, 1)))
    metrics = by_u[..., :, None] * by_u[..., None, :] + by_v[..., :, None] * by_v[..., None, :]
    response = np.empty((rows, columns), np.float32)
    for row in range(rows):  # in pieces that stay in the cache
        response[row] = series.at(mm[row] + _smooth(mm[row], correction), metrics[row])
    return Flat.of(response, "print")
