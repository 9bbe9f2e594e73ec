"""What one spot of a scan shows of the print that it lies on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from altd.calibration.printed.plane import Plane
from altd.records import FloatArray, Frame
from altd.vision.flat import Flat
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.image import Mask
from altd.vision.localise import SATURATED_FROM
from altd.vision.profile import fit_profile
from altd.vision.settings import SpotSettings

_MIN_SHARE_OF_PEAK = 0.15
_PART_PIXELS = 1 << 13
_TEXTURE_SIGMA = 0.15
"""Relative scatter that a pixel keeps beside the print: limits the weight of bright pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """The lit pixels of one node.

    ``mm`` (n, 2) is where on the target they look, ``ratio`` (n,) their light relative to that of the spot on
    even ground, ``weight`` (n,) the inverse of its variance, ``metric`` (2, 2) mm²/px² the scale there.
    """

    mm: FloatArray
    ratio: FloatArray
    weight: FloatArray
    metric: FloatArray

    @property
    def nbytes(self) -> int:
        """What it takes in memory."""
        return self.mm.nbytes + self.ratio.nbytes + self.weight.nbytes + self.metric.nbytes

    def parts(self) -> Iterator[Sample]:
        """The same pixels, some thousand at a time: what is made of each is a hundred times as large."""
        for start in range(0, len(self.ratio), _PART_PIXELS):
            part = slice(start, start + _PART_PIXELS)
            yield Sample(self.mm[part], self.ratio[part], self.weight[part], self.metric)


def sample_of(frame: Frame, plane: Plane, settings: SpotSettings, flat: Flat | None) -> Sample | None:
    """The sample of a frame; None where it has no spot, or none that a profile fits.

    Without a flat the light is taken relative to the smoothed spot, with one to the fitted profile.
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
        profile = fit_profile(
            patch, flat, _diameter_px(patch.mask), noise, clipped if clipped.any() else None
        )
        if profile is None:
            return None
        light, even = light - profile.background_offset, profile.irradiance(u, v)
    lit = (even > _MIN_SHARE_OF_PEAK * even.max()) & ~clipped
    variance = (noise.read_counts**2 + even[lit] / noise.electrons_per_count) / even[lit] ** 2
    px = np.stack(np.meshgrid(u, v), axis=-1)[lit]
    return Sample(
        plane.to_mm(px),
        light[lit] / even[lit],
        1 / (_TEXTURE_SIGMA**2 + variance),
        plane.metric(px.mean(axis=0)),
    )


def _diameter_px(mask: Mask) -> float:
    return float(np.sqrt(np.count_nonzero(mask) * 4 / np.pi))
