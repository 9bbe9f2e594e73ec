"""The print under one spot of a scan, and the place on the target that each pixel shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from altd.mapping.tensor_map import TensorMap
from altd.records import FloatArray, Frame
from altd.vision.flat import Flat
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.image import SATURATED_FROM
from altd.vision.profile import fit_profile
from altd.vision.settings import SpotSettings

_MARGIN_MM = 8.0
_POINTS_ACROSS = 50
_DEGREE = 8


class PolynomialInverse:
    """The inverse of a map as one polynomial, fast for many pixels.

    It is accurate to nanometres over the nodes' rectangle and a margin of 8 mm, which spots at the outer
    nodes reach.
    """

    def __init__(self, fitted: TensorMap) -> None:
        x, y = (
            np.linspace(axis.first_mm - _MARGIN_MM, axis.last_mm + _MARGIN_MM, _POINTS_ACROSS)
            for axis in (fitted.x_axis, fitted.y_axis)
        )
        mm = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        px = fitted.to_px(mm)
        self._middle = px.mean(axis=0)
        self._scale = float(np.abs(px - self._middle).max())
        u, v = self._powers(px[:, 0], 0), self._powers(px[:, 1], 1)
        i, j = np.nonzero(np.add.outer(np.arange(_DEGREE + 1), np.arange(_DEGREE + 1)) <= _DEGREE)
        self._coefficients = np.zeros((2, _DEGREE + 1, _DEGREE + 1))
        self._coefficients[:, i, j] = np.linalg.lstsq(u[:, i] * v[:, j], mm, rcond=None)[0].T

    def to_mm(self, px: FloatArray) -> FloatArray:
        """Convert points (n, 2) px to (n, 2) mm."""
        u, v = self._powers(px[:, 0], 0), self._powers(px[:, 1], 1)
        return np.stack([((u @ coefficients) * v).sum(axis=1) for coefficients in self._coefficients], axis=1)

    def grid_mm(self, rows: int, columns: int) -> FloatArray:
        """Places of all pixels of a picture, (rows, columns, 2) mm."""
        u = self._powers(np.arange(columns, dtype=np.float64), 0)
        v = self._powers(np.arange(rows, dtype=np.float64), 1)
        return np.stack([v @ coefficients.T @ u.T for coefficients in self._coefficients], axis=-1)

    def metric(self, px: FloatArray) -> FloatArray:
        """J Jᵀ (2, 2) in mm²/px² at a point (2,) px, with J = d(mm)/d(px)."""
        ends = self.to_mm(px + 0.5 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]))
        jacobian = np.column_stack([ends[0] - ends[1], ends[2] - ends[3]])
        return np.asarray(jacobian @ jacobian.T)

    def _powers(self, px: FloatArray, axis: int) -> FloatArray:
        return np.vander((px - self._middle[axis]) / self._scale, _DEGREE + 1, increasing=True)


_MIN_SHARE_OF_PEAK = 0.15
_PART_PIXELS = 1 << 13
_TEXTURE_SIGMA = 0.15
"""Relative scatter of a pixel in addition to the print; limits the weight of bright pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class NodePixels:
    """The lit pixels of one node.

    ``mm`` (n, 2) are their places on the target, ``ratio`` (n,) their light relative to that of the spot on
    even ground, ``weight`` (n,) the inverse of its variance, ``metric`` (2, 2) mm²/px² the scale there.
    """

    mm: FloatArray
    ratio: FloatArray
    weight: FloatArray
    metric: FloatArray

    @property
    def nbytes(self) -> int:
        """Size in memory, bytes."""
        return self.mm.nbytes + self.ratio.nbytes + self.weight.nbytes + self.metric.nbytes

    def parts(self) -> Iterator[NodePixels]:
        """Yield the pixels, some thousand at a time: data derived from each is a hundred times as large."""
        for start in range(0, len(self.ratio), _PART_PIXELS):
            part = slice(start, start + _PART_PIXELS)
            yield NodePixels(self.mm[part], self.ratio[part], self.weight[part], self.metric)


def sample_of(
    frame: Frame, plane: PolynomialInverse, settings: SpotSettings, flat: Flat | None
) -> NodePixels | None:
    """Take the sample of a frame; None if it has no spot, or with a flat none that a profile fits.

    The light is relative to the smoothed spot, with a flat to the fitted profile.
    """
    analysis = FrameAnalysis(frame, settings)
    patch = analysis.brightest_patch
    if patch is None:
        return None
    noise = analysis.noise
    height, width = patch.excess.shape
    window = slice(patch.top, patch.top + height), slice(patch.left, patch.left + width)
    clipped = frame.pixels[window] >= SATURATED_FROM * frame.full_scale
    u = np.arange(patch.left, patch.left + width, dtype=np.float64)
    v = np.arange(patch.top, patch.top + height, dtype=np.float64)
    light, even = patch.excess.astype(np.float64), patch.smooth.astype(np.float64)
    if flat is not None:
        diameter_px = float(np.sqrt(np.count_nonzero(patch.mask) * 4 / np.pi))
        profile = fit_profile(patch, flat, diameter_px, noise, clipped if clipped.any() else None)
        if profile is None:
            return None
        light, even = light - profile.background_offset, profile.irradiance(u, v)
    lit = (even > _MIN_SHARE_OF_PEAK * even.max()) & ~clipped
    variance = (noise.read_counts**2 + even[lit] / noise.electrons_per_count) / even[lit] ** 2
    px = np.stack(np.meshgrid(u, v), axis=-1)[lit]
    return NodePixels(
        plane.to_mm(px),
        light[lit] / even[lit],
        1 / (_TEXTURE_SIGMA**2 + variance),
        plane.metric(px.mean(axis=0)),
    )
