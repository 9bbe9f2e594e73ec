"""Model the print under the spots of a scan from its frames.

Printed dots form a lattice: two reciprocal vectors and a Fourier series describe the light that each place
sends to the camera. The lattice is regular in the plane of the print, so it also shows where the map bends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from altd.calibration.printed.lattice import Lattice, find_lattice
from altd.calibration.printed.sample import NodePixels, PolynomialInverse, sample_of
from altd.calibration.scan_nodes import NodeCache
from altd.mapping.nodes import Fiducials
from altd.mapping.tensor_map import TensorMap
from altd.records import ComplexArray, FloatArray, Frame
from altd.vision.flat import Flat
from altd.vision.settings import SpotSettings

_RIDGE = 1e-6
_MAX_WEAKENING = 40.0
"""Limit in radians² per px²: higher harmonics are weakened no further, or noise would replace them."""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """F over the print's plane: ``mean``, then ``amplitudes``, one complex number per harmonic.

    Lens and pixel blur the whole picture equally, by ``blur_px``, so harmonics are weaker where the picture
    of the print is small. The amplitudes are those of the print itself.
    """

    lattice: Lattice
    mean: float
    amplitudes: ComplexArray
    blur_px: float

    @classmethod
    def fit(cls, lattice: Lattice, samples: Iterable[NodePixels], blurs_px: Sequence[float]) -> Series:
        """Fit all samples by weighted least squares, with the blur of ``blurs_px`` that fits best.

        The samples are read once; their normal equations are summed. A blur weakens a harmonic equally in
        the whole of a sample, so the equations of each blur are those without blur, scaled.
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
        """Amplitude of the weaker of the two fundamental waves, over the mean."""
        fundamental = np.abs(self.lattice.harmonics).sum(axis=1) == 1
        return float(np.abs(self.amplitudes[fundamental]).min() / self.mean)

    def values(self, mm: FloatArray, metrics: FloatArray) -> FloatArray:
        """F at points (n, 2) mm with their metrics (n, 2, 2) mm²/px²."""
        waves = self.lattice.waves(mm)
        waves *= _dimming(self.lattice, metrics, self.blur_px)
        response: FloatArray = self.mean + (waves @ self.amplitudes).real
        return response

    def offset_mm(self, sample: NodePixels) -> FloatArray:
        """Offset (2,) of a node's print from the series: F(x + offset) fits its light best."""
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

    They square the condition, which is harmless here: the waves of a lattice are nearly orthogonal over the
    pixels of a scan, so the matrix, scaled to a diagonal of 1, has a condition of 1.0 to 1.2
    (docs/decisions/0029-memory.md). Unscaled, the condition is up to 10¹³, because a blur leaves almost
    nothing of the highest harmonics.
    """

    normal: FloatArray
    right: FloatArray
    square: float

    @classmethod
    def empty(cls, size: int) -> _Sums:
        """Return the equations of no sample."""
        return cls(np.zeros((size, size)), np.zeros(size), 0.0)

    def add(self, sample: NodePixels, waves: ComplexArray) -> None:
        """Add the pixels of a sample, at which the waves are (n, harmonics)."""
        design = np.column_stack([np.ones(len(waves)), waves.real, -waves.imag])
        weighted = design * sample.weight[:, None]
        self.normal += weighted.T @ design
        self.right += weighted.T @ sample.ratio
        self.square += float(sample.weight @ np.square(sample.ratio))

    def add_scaled(self, other: _Sums, scale: FloatArray) -> None:
        """Add the sums of ``other``, its columns times ``scale`` (p,)."""
        self.normal += other.normal * scale * scale[:, None]
        self.right += other.right * scale
        self.square += other.square

    def solved(self) -> tuple[FloatArray, float]:
        """Return the solution (p,) and its remaining cost: Σ weight · rest²."""
        ridged = self.normal + _RIDGE * np.eye(len(self.right))
        scale = 1 / np.sqrt(ridged.diagonal())
        solution = scale * np.linalg.solve(ridged * scale * scale[:, None], self.right * scale)
        return np.asarray(solution), self.square - float(solution @ (2 * self.right - self.normal @ solution))


def _dimming(lattice: Lattice, metrics: FloatArray, blur_px: float) -> FloatArray:
    """Factor of a Gaussian blur on each harmonic, (places, harmonics), at metrics (places, 2, 2)."""
    x, y = lattice.vectors.T
    squared = (
        metrics[:, 0, 0, None] * x * x + 2 * metrics[:, 0, 1, None] * x * y + metrics[:, 1, 1, None] * y * y
    )
    weaker: FloatArray = np.exp(-0.5 * blur_px**2 * np.minimum(squared, _MAX_WEAKENING))
    return weaker


_MIN_CONTRAST = 0.1
"""Minimum contrast: 0.15 mm dots, 0.6 mm apart, have 0.24 at 4 px/mm; the plain spot's own shape has 0.02."""
_MIN_NODES = 12
_BLURS_PX = 0.3, 0.5, 0.7, 0.9, 1.1
_ITERATIONS = 2
_CUBIC_TERMS = 10
"""Number of terms of a cubic in two coordinates."""
_CUBIC_UNIT_MM = 50.0
_MIN_FIDUCIAL_SIGMA_MM = 0.002
"""Minimum sigma: neither print nor a node's spread of dots over a bent picture is more regular."""


@dataclass(frozen=True, slots=True, eq=False)
class Print:
    """The print in a scan: its lattice, the flat of its picture, and its places at the nodes."""

    lattice: Lattice
    flat: Flat
    fiducials: Fiducials


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """A print on its plane.

    ``series`` is its brightness, ``bend`` (10, 2) its offset from the map, as a cubic of the place.
    ``regular_mm`` (n, 2) are the nodes' coordinates on it, ``sigma_mm`` is their standard deviation.
    """

    series: Series
    bend: FloatArray
    regular_mm: FloatArray
    sigma_mm: float

    @classmethod
    def first(cls, lattice: Lattice, samples: NodeCache[NodePixels], centres_mm: FloatArray) -> _Model:
        """Build the first model, as if the map were true; later models keep its blur, which fits best."""
        series = Series.fit(lattice, samples, _BLURS_PX)
        return cls._through(series, np.zeros((_CUBIC_TERMS, 2)), samples, centres_mm)

    def next(self, samples: NodeCache[NodePixels], centres_mm: FloatArray) -> _Model:
        """Return a better model, from samples that were taken through this one's flat."""
        series = Series.fit(self.series.lattice, self._regular(samples), (self.series.blur_px,))
        return self._through(series, self.bend, self._regular(samples), centres_mm)

    def _regular(self, samples: NodeCache[NodePixels]) -> Iterator[NodePixels]:
        """Yield the samples with their places on the print."""
        return (replace(sample, mm=self.moved(sample.mm)) for sample in samples)

    @classmethod
    def _through(
        cls, series: Series, bend: FloatArray, regular: Iterable[NodePixels], centres_mm: FloatArray
    ) -> _Model:
        """Build a model: its bend is the cubic part of the nodes' offsets, the rest is their error."""
        cubic = _cubic(centres_mm)
        off_mm = cubic @ bend + np.array([series.offset_mm(sample) for sample in regular])
        bend = np.asarray(np.linalg.lstsq(cubic, off_mm, rcond=None)[0])
        freedom = max(off_mm.size - bend.size, 1)
        sigma_mm = float(np.sqrt(np.square(off_mm - cubic @ bend).sum() / freedom))
        return cls(series, bend, centres_mm + off_mm, max(sigma_mm, _MIN_FIDUCIAL_SIGMA_MM))

    def moved(self, places_mm: FloatArray) -> FloatArray:
        """Places on the print, (n, 2) mm, of places (n, 2) mm of the map."""
        moved: FloatArray = places_mm + _cubic(places_mm) @ self.bend
        return moved


def find_print(
    frame_of: Callable[[int], Frame], nodes_px: FloatArray, first_map: TensorMap, settings: SpotSettings
) -> Print | None:
    """Find the print under the spots at a scan's nodes; None if there is none or it is not regular.

    ``frame_of`` returns one exposure of a node by its number, ``nodes_px`` (n, 2) are the spots' positions,
    ``first_map`` is a map good to a tenth of a dot pitch. Memory is limited: only a part of the samples is
    kept at a time; the rest is made again from the frames.
    """
    plane = PolynomialInverse(first_map)

    def seen_through(flat: Flat | None) -> NodeCache[NodePixels]:
        """Return samples of the print at the nodes that have one."""
        return NodeCache(
            len(nodes_px),
            lambda node: sample_of(frame_of(node), plane, settings, flat),
            lambda sample: sample.nbytes,
        )

    samples = seen_through(None)
    if len(samples) < _MIN_NODES:
        return None
    lattice = find_lattice(samples, plane.to_mm(nodes_px[samples.nodes]))
    if lattice is None:
        return None
    rows, columns = frame_of(0).pixels.shape
    picture_mm = plane.grid_mm(rows, columns)
    model = _Model.first(lattice, samples, plane.to_mm(nodes_px[samples.nodes]))
    if model.series.contrast < _MIN_CONTRAST:
        return None
    for _ in range(_ITERATIONS):
        del samples  # two caches at a time would need twice the memory
        samples = seen_through(_flat(model, picture_mm))
        if len(samples) < _MIN_NODES:
            return None
        model = model.next(samples, plane.to_mm(nodes_px[samples.nodes]))
    fiducials = Fiducials(nodes_px[samples.nodes], model.regular_mm, model.sigma_mm)
    return Print(lattice, _flat(model, picture_mm), fiducials)


def _cubic(mm: FloatArray) -> FloatArray:
    x, y = mm.T / _CUBIC_UNIT_MM
    xx, yy = x * x, y * y
    return np.stack([np.ones(len(x)), x, y, xx, x * y, yy, xx * x, xx * y, x * yy, yy * y], axis=1)


def _flat(model: _Model, picture_mm: FloatArray) -> Flat:
    """Compute F at every pixel of a picture whose pixels show the places (rows, columns, 2) mm."""
    by_v, by_u = (np.asarray(slope) for slope in np.gradient(picture_mm, axis=(0, 1)))
    metrics = by_u[..., :, None] * by_u[..., None, :] + by_v[..., :, None] * by_v[..., None, :]
    response = np.empty(picture_mm.shape[:2], np.float32)
    for row, (mm, metric) in enumerate(zip(picture_mm, metrics, strict=True)):  # a row fits the cache
        response[row] = model.series.values(model.moved(mm), metric)
    return Flat.from_response(response, "print")
