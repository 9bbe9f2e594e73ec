"""Dust and dirt under a spot: what is dark there now and was not when the target was calibrated.

A speck is opaque and has an edge; the print and the grain of the target are known, a drift of the camera
moves them, and the laser's power, the exposure and smears without an edge change all of a spot alike. So the
specks are what is left of the light's fine structure, once the texture at its best shift is taken off, where
it is far darker than the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from altd.statistics import MAD_TO_SIGMA
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.image import Image
from altd.vision.texture import MAX_SHIFT_PX, Sample, Texture, match, sample_of

_MIN_LOSS = 0.4
"""Of a pixel's light. The model of a print is wrong by less where its dots have their edges, an image that
moved by a part of a pixel too."""
_LOSS_SIGMAS = 5.0
"""Of the pixel's own noise, and of what most pixels of the spot differ by: coarse grain is no dust."""
_MAX_NOISE = 0.1
"""A pixel whose light is known worse than this is not looked at: the flanks of a spot."""
_MIN_EXPECTED = 0.7
"""Nor is one that shows less than this share of the light about it: the gaps of a print."""
_MIN_TOGETHER = 2.0
"""Pixels of a speck, among a pixel and its eight neighbours: blurred by the lens, none is dark alone."""
_MIN_PIXELS = 100
_DARKEST = 0.01
_MAX_GRAIN = 0.2
"""Contrast of a target's texture from which it is printed (``fingerprint``)."""


@dataclass(frozen=True, slots=True)
class DustCount:
    """The pixels under a spot that were looked at, and how many of them are covered."""

    covered: int
    looked_at: int


def count_dust(analysis: FrameAnalysis, texture: Texture) -> DustCount | None:
    """Dust over the brightest spot of a frame; None where too little is seen or known, or clipped.

    A pixel is covered where 40 % of its light are missing. Takes about a millisecond.
    """
    sample = sample_of(analysis)
    expected = None if sample is None else _expected(sample, texture)
    if sample is None or expected is None or sample.is_clipped:
        return None
    noise = np.sqrt(sample.variance) / expected
    is_used = (noise < _MAX_NOISE) & (expected > _MIN_EXPECTED)
    looked_at = int(is_used.sum())
    if looked_at < _MIN_PIXELS:
        return None
    loss = 1 - (1 + sample.relative) / expected
    usual = loss[is_used]
    deviation = MAD_TO_SIGMA * float(np.median(np.abs(usual - np.median(usual))))
    limit = np.maximum(max(_MIN_LOSS, _LOSS_SIGMAS * deviation), _LOSS_SIGMAS * noise)
    is_dark = (is_used & (loss > limit)).astype(np.uint8)
    together = cv2.boxFilter(is_dark, cv2.CV_32F, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return DustCount(int(np.count_nonzero(is_dark & (together >= _MIN_TOGETHER))), looked_at)


def _expected(sample: Sample, texture: Texture) -> Image | None:
    """The light of each pixel of a sample, as a share of what is about it, as the calibration has it.

    A plate of which nothing is known there has a grain that is no dust; a print would be. None: not known.
    """
    found = match(sample, texture)
    if found is None:
        return np.ones_like(sample.relative) if texture.contrast < _MAX_GRAIN else None
    shift = np.array([[1.0, 0.0, MAX_SHIFT_PX - found.u_px], [0.0, 1.0, MAX_SHIFT_PX - found.v_px]])
    rows, columns = sample.relative.shape
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    moved = cv2.warpAffine(texture.around(sample), shift, (columns, rows), flags=flags)
    gain = min(max(found.gain, 0.0), 1.0)
    return np.asarray(np.maximum(1 + gain * moved, _DARKEST), dtype=np.float32)
