"""Surface texture under a spot, print or plate, and its shift since the calibration.

A camera in its calibrated place sees the same texture at the same pixels, wherever the spot is. The relative
brightness under the spot is correlated with the texture of the calibration. The peak's position is the shift
of the image, and the residual of the peak, correlated in the same way, is its noise. So the significance of a
peak follows from the frame itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import FloatArray
from altd.vision.flat import Flat
from altd.vision.frame_analysis import FrameAnalysis, Patch
from altd.vision.image import Image, gaussian_blur

MAX_SHIFT_PX = 12
"""Maximum lag that is searched, either way in u and v."""

_SMOOTHING_PX = 4.0
"""Sigma of the Gaussian that separates texture from the shape of a spot: about one dot pitch."""
_MIN_SHARE_OF_PEAK = 0.05
_MODEL_SIGMA = 0.1
"""Relative error of even a bright pixel: speckle that moved, dust, the model of a print."""
_MAX_RELATIVE = 1.5
_MAX_CLIPPED_SHARE = 0.1
_MIN_RESPONSE = 1e-3
_MIN_OVERLAP = 0.25
"""Minimum energy of the texture under the spot, as a share of the best covered lag's; lags with less do not
count."""
_MIN_ENERGY = 1e-3
_RESOLVED_PX, _MERGED_PX = 0.7, 8.0
"""Distances of a second image: a nearer one is a shift of the first; a farther one distorts the spot."""
_MIN_AMPLITUDE = 0.1
_RIVAL_SIGMAS = 7.0
_INTERPOLATION_LOSS = 0.02
"""Share by which an equally good peak may be lower: a print repeats itself, and the nearest peak is taken."""
_MIN_RIVAL_SHARE = 0.7
"""Minimum share of its score that a peak between two lags keeps at the better one (dots four px apart)."""
_MIN_REFINED_SIGNIFICANCE = 20.0
"""Minimum significance for refinement: below it the noise of a shift is larger than a parabola's error."""
_MIN_REFINED_PX = 0.03
"""Minimum offset that is refined: calibrated views have smaller ones, which would become a displacement."""
_MAX_REFINEMENT = 4.0
"""Maximum ratio to a parabola's offset f: its vertex on straight sides of unequal length is f / (4 − 6 f)."""
_CORRELATED_PIXELS = 4.0
"""Maximum number of neighbours whose noise smoothing and clipping correlate."""


@dataclass(frozen=True, eq=False)
class TextureSample:
    """Relative brightness of the pixels under one spot.

    ``relative`` (h, w) is light over smoothed light − 1, ``variance`` (h, w) its variance by photons,
    read-out and smoothing, infinite where a pixel does not count; ``left`` and ``top`` are its position in
    the frame. ``is_clipped``: more than a tenth of the spot's core is at or near clipped pixels.
    """

    left: int
    top: int
    relative: Image
    variance: Image
    is_clipped: bool = False

    @cached_property
    def weight(self) -> Image:
        """Weight of each pixel in a comparison, (h, w)."""
        return np.asarray(1 / (self.variance + np.float32(_MODEL_SIGMA**2)), dtype=np.float32)

    @property
    def contrast(self) -> float:
        """Relative scatter that noise does not explain; 0 if noise may explain all of it."""
        energy, noise = self.energy
        return math.sqrt(energy / float(self.weight.sum())) if energy > noise else 0.0

    @cached_property
    def energy(self) -> tuple[float, float]:
        """Sum of the weighted squares of the relative brightness less those of noise, and its uncertainty."""
        noise = (self.weight * np.where(np.isfinite(self.variance), self.variance, 0)).ravel()
        energy = float(np.sum(self.weight * np.square(self.relative))) - float(noise.sum())
        return energy, math.sqrt(2 * _CORRELATED_PIXELS * float(noise @ noise))


def sample_of(analysis: FrameAnalysis) -> TextureSample | None:
    """Return the sample under the brightest spot of a frame; None if there is no spot."""
    patch = analysis.brightest_patch
    if patch is None:
        return None
    noise = analysis.noise
    once = (
        patch.smooth
        if analysis.settings.smoothing_px == _SMOOTHING_PX
        else gaussian_blur(patch.excess, _SMOOTHING_PX)
    )
    smooth, correction = _curvature_preserving(once)
    clipped = _near_clipped(patch)
    is_used = (smooth > _MIN_SHARE_OF_PEAK * patch.peak) & ~clipped
    light = np.where(is_used, smooth, np.float32(1))
    relative = np.where(is_used, np.clip(patch.excess / light - 1, -1, _MAX_RELATIVE), 0)
    variance = (noise.read_counts**2 + light / noise.electrons_per_count) / np.square(light)
    variance += np.square(np.square(correction / light))
    variance = np.where(is_used, variance, np.inf)
    return TextureSample(
        patch.left,
        patch.top,
        relative.astype(np.float32),
        variance.astype(np.float32),
        bool(np.mean(clipped[smooth > 0.5 * patch.peak]) > _MAX_CLIPPED_SHARE),
    )


def stacked(samples: Sequence[TextureSample]) -> TextureSample:
    """Combine several samples of the same view into one, over all pixels that any of them covers.

    The noise of photons and read-out averages out; texture remains, wherever the spot was.
    """
    left, top = min(each.left for each in samples), min(each.top for each in samples)
    right = max(each.left + each.relative.shape[1] for each in samples)
    bottom = max(each.top + each.relative.shape[0] for each in samples)
    weight, light, noise = np.zeros((3, bottom - top, right - left), dtype=np.float32)
    for each in samples:
        rows, columns = each.relative.shape
        part = np.s_[each.top - top : each.top - top + rows, each.left - left : each.left - left + columns]
        weight[part] += each.weight
        light[part] += each.weight * each.relative
        noise[part] += np.square(each.weight) * np.where(np.isfinite(each.variance), each.variance, 0)
    is_covered = weight > 0
    divisor = np.where(is_covered, weight, np.float32(1))
    variance = np.where(is_covered, noise / np.square(divisor), np.float32(np.inf))
    return TextureSample(left, top, light / divisor, variance, any(each.is_clipped for each in samples))


def _curvature_preserving(once: Image) -> tuple[Image, Image]:
    """Return an image smoothed ``once`` by G as by 2G − G², whose second moment is zero; and the correction.

    If a correction of relative size b was needed, on a steep flank, an error of about b² remains.
    """
    correction = once - gaussian_blur(once, _SMOOTHING_PX)
    return np.asarray(once + correction, dtype=np.float32), np.asarray(correction, dtype=np.float32)


def _near_clipped(patch: Patch) -> npt.NDArray[np.bool_]:
    """Return the pixels whose smoothed surroundings lack clipped light; a single one is a hot pixel."""
    if patch.pixels.max() < patch.clipped_from:
        return np.zeros(patch.pixels.shape, dtype=np.bool_)
    clipped = (patch.pixels >= patch.clipped_from).astype(np.uint8)
    several = cv2.boxFilter(clipped, cv2.CV_32F, (3, 3), normalize=False) > 1
    reach = 2 * round(2 * _SMOOTHING_PX) + 1
    near = cv2.dilate((several & (clipped > 0)).astype(np.uint8), np.ones((reach, reach), np.uint8))
    return np.asarray((near > 0) | (clipped > 0))


@dataclass(frozen=True, eq=False)
class Texture:
    """Expected relative brightness − 1 of each pixel, ``relative`` (rows, columns); 0 where unknown."""

    relative: Image

    @classmethod
    def of_flat(cls, flat: Flat) -> Self:
        """Return the texture of a target whose flat field is known."""
        smooth, _ = _curvature_preserving(gaussian_blur(flat.response, _SMOOTHING_PX))
        smooth = np.maximum(smooth, np.float32(_MIN_RESPONSE))
        relative = np.where(flat.levels > 0, np.clip(flat.response / smooth - 1, -1, _MAX_RELATIVE), 0)
        return cls(relative.astype(np.float32))

    @cached_property
    def _padded(self) -> Image:
        return np.pad(self.relative, MAX_SHIFT_PX)

    @cached_property
    def contrast(self) -> float:
        """Root mean square of the known pixels."""
        known = self.relative[self.relative != 0]
        return float(np.sqrt(np.mean(np.square(known)))) if known.size else 0.0

    def around(self, sample: TextureSample, moved: FloatArray | None = None) -> Image:
        """Return the relative brightness under a sample and MAX_SHIFT_PX around it; 0 where unknown.

        ``moved`` (2, 3) maps (u, v, 1) of the texture to its position in the sample's frame; None: unmoved.
        Only the requested part is warped, so the size of the picture costs nothing.
        """
        rows, columns = (size + 2 * MAX_SHIFT_PX for size in sample.relative.shape)
        if moved is None:
            return self._padded[sample.top : sample.top + rows, sample.left : sample.left + columns]
        corner_px = np.array([sample.left, sample.top]) - MAX_SHIFT_PX
        to_part = np.column_stack([moved[:, :2], moved[:, 2] - corner_px])
        return np.asarray(
            cv2.warpAffine(self.relative, to_part, (columns, rows), flags=cv2.INTER_LANCZOS4), np.float32
        )


@dataclass(frozen=True, slots=True)
class TextureMatch:
    """Agreement of a sample with a texture.

    ``u_px``, ``v_px`` is the shift of the image, ``sigma_px`` the noise of either; ``significance`` is the
    peak over its noise, ``expected`` its value if the sample were the texture, and ``strength`` its value if
    besides only known noise disturbed it. ``gain`` is the share of the texture's amplitude in the sample,
    ``explained`` the share of the sample's contrast, less noise, that the texture explains; 1 if noise or
    clipping hides the contrast. ``doubled_px`` is the possible displacement of the spot by a second image of
    the texture, seen through water or a second pane: its share times its distance.
    """

    u_px: float
    v_px: float
    sigma_px: float
    significance: float
    strength: float
    expected: float
    gain: float
    explained: float
    doubled_px: float = 0.0

    @property
    def shift_px(self) -> float:
        """Distance by which the image moved."""
        return math.hypot(self.u_px, self.v_px)


def match(sample: TextureSample, texture: Texture, moved: FloatArray | None = None) -> TextureMatch | None:
    """Correlate a sample with a texture; None if nothing, or too little, is known under the spot.

    The shift counts from the position by ``moved`` (2, 3): see ``Texture.around``. Takes about 0.2 ms for a
    spot of 60 px.
    """
    expected, weight = texture.around(sample, moved), sample.weight
    energy = np.maximum(_cross_correlation(np.square(expected), weight), 0)
    usable = energy > max(_MIN_OVERLAP * float(energy.max()), _MIN_ENERGY)
    if not usable[MAX_SHIFT_PX, MAX_SHIFT_PX]:
        return None
    root = np.sqrt(np.where(usable, energy, 1))
    score = np.where(usable, _cross_correlation(expected, weight * sample.relative) / root, 0)
    best = _Peak.at(score, (int(score.argmax()) // score.shape[1], int(score.argmax()) % score.shape[1]))
    if score[best.lag] <= 0:
        return None
    height, gain, residual = _projected(sample, best.displaced(expected, sample.relative.shape))
    left = np.where(usable, _cross_correlation(expected, weight * residual) / root, np.float32(0))
    noise = max(float(np.sqrt(np.mean(np.square(left[usable])))), 1e-9)
    if height > _MIN_REFINED_SIGNIFICANCE * noise:
        best = best.refined(sample, expected)
    chosen = best
    nearest_lag = _nearest_peak(score, _MIN_RIVAL_SHARE * float(score[best.lag]))
    if nearest_lag != best.lag:
        nearest = _Peak.at(score, nearest_lag)
        rival_height, rival_gain, _ = _projected(sample, nearest.displaced(expected, sample.relative.shape))
        if rival_height >= (1 - _INTERPOLATION_LOSS) * height - _RIVAL_SIGMAS * noise:
            chosen, height, gain = nearest.refined(sample, expected), rival_height, rival_gain
    seen, uncertain = sample.energy
    return TextureMatch(
        u_px=MAX_SHIFT_PX - chosen.lag[1] - chosen.offset_u,
        v_px=MAX_SHIFT_PX - chosen.lag[0] - chosen.offset_v,
        sigma_px=noise / math.sqrt(max(height * chosen.curvature, 1e-12)),
        significance=height / noise,
        strength=float(root[MAX_SHIFT_PX, MAX_SHIFT_PX]),
        expected=float(root[MAX_SHIFT_PX, MAX_SHIFT_PX]) / noise,
        gain=gain,
        explained=min(height**2 / seen, 1.0) if seen > 10 * uncertain and not sample.is_clipped else 1.0,
        doubled_px=_doubled_px(np.asarray(left / root, np.float32), gain, chosen),
    )


def _doubled_px(amplitudes: Image, of_first: float, first: _Peak) -> float:
    """Return share times distance of the second image that displaces most, from the residual amplitudes."""
    rows, columns = (np.arange(size) for size in amplitudes.shape)
    distance_px = np.hypot(
        (rows - first.lag[0] - first.offset_v)[:, None], columns - first.lag[1] - first.offset_u
    )
    is_merged = (distance_px > _RESOLVED_PX) & (distance_px < _MERGED_PX)
    return float(np.max(np.where(is_merged, amplitudes * distance_px, 0))) / max(of_first, _MIN_AMPLITUDE)


@dataclass(frozen=True, slots=True)
class _Peak:
    """Peak of the score: its lag (row, column), the offset of its vertex from it, and its curvature."""

    lag: tuple[int, int]
    offset_u: float
    offset_v: float
    curvature: float

    @classmethod
    def at(cls, score: Image, lag: tuple[int, int]) -> Self:
        """Return the peak at a lag, with the parabola's vertex along either axis."""
        offset_u, curvature_u = _vertex(score[lag[0]], lag[1])
        offset_v, curvature_v = _vertex(score[:, lag[1]], lag[0])
        return cls(lag, offset_u, offset_v, min(curvature_u, curvature_v))

    def refined(self, sample: TextureSample, expected: Image) -> Self:
        """Return the peak with the offsets of best fit of the expected texture, interpolated between lags.

        Pixels average texture as fine as they are: its score has straight sides, and the parabola finds as
        little as a quarter of an offset. Averaging is a linear interpolation of four lags, whose shares in
        the least-squares sum are the offset. Coarse texture is nearly linear from one lag to the next. Blur
        takes shares too, but does not move the parabola, whose offset limits them on both sides.
        """
        rows, columns = sample.weight.shape
        row, column = self.lag
        next_row = row + (1 if self.offset_v >= 0 else -1)
        next_column = column + (1 if self.offset_u >= 0 else -1)
        is_inside = {next_row, next_column} <= set(range(2 * MAX_SHIFT_PX + 1))
        if not is_inside or math.hypot(self.offset_u, self.offset_v) < _MIN_REFINED_PX:
            return self
        textures = np.empty((4, rows * columns), np.float32)
        lags = ((row, column), (row, next_column), (next_row, column), (next_row, next_column))
        for texture, (top, left) in zip(textures, lags, strict=True):
            texture[:] = expected[top : top + rows, left : left + columns].ravel()
        weighted = textures * sample.weight.ravel()
        shares = np.linalg.lstsq(weighted @ textures.T, weighted @ sample.relative.ravel(), rcond=None)[0]
        whole = float(shares.sum())
        if whole <= 0:
            return self
        parts = ((shares[1:3] + shares[3]) / whole).tolist()
        offset_u, offset_v = (
            math.copysign(min(max(part, abs(offset)), _MAX_REFINEMENT * abs(offset), 1.0), offset)
            for part, offset in zip(parts, (self.offset_u, self.offset_v), strict=True)
        )
        return replace(self, offset_u=offset_u, offset_v=offset_v)

    def displaced(self, expected: Image, shape: tuple[int, ...]) -> Image:
        """Return the expected content of the sample at this peak, (h, w)."""
        shift = np.array([[1.0, 0.0, self.lag[1] + self.offset_u], [0.0, 1.0, self.lag[0] + self.offset_v]])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpAffine(expected, shift, (shape[1], shape[0]), flags=flags), np.float32)


def _projected(sample: TextureSample, shifted: Image) -> tuple[float, float, Image]:
    """Return score and gain of the expected texture at a peak, and the residual of the sample."""
    energy = max(float(np.sum(sample.weight * np.square(shifted))), _MIN_ENERGY)
    gain = float(np.sum(sample.weight * sample.relative * shifted)) / energy
    return gain * math.sqrt(energy), gain, sample.relative - np.float32(gain) * shifted


def _cross_correlation(expected: Image, pattern: Image) -> Image:
    """Return Σ over the pixels of a sample at each lag, (2 MAX_SHIFT_PX + 1,) squared."""
    return np.asarray(cv2.matchTemplate(expected, pattern, cv2.TM_CCORR), dtype=np.float32)


def _nearest_peak(score: Image, at_least: float) -> tuple[int, int]:
    """Return the local maximum nearest to the middle among those of at least that score."""
    peaks = (score >= cv2.dilate(score, np.ones((3, 3), np.uint8))) & (score >= at_least)
    rows, columns = np.nonzero(peaks)
    nearest = int(np.hypot(rows - MAX_SHIFT_PX, columns - MAX_SHIFT_PX).argmin())
    return int(rows[nearest]), int(columns[nearest])


def _vertex(values: Image, at: int) -> tuple[float, float]:
    """Return the vertex of the parabola through three values, from the middle one, and its curvature."""
    if not 0 < at < len(values) - 1:
        return 0.0, 0.0
    before, here, after = (float(value) for value in values[at - 1 : at + 2])
    curvature = 2 * here - before - after
    return (0.0, 0.0) if curvature <= 0 else ((after - before) / (2 * curvature), curvature)
