"""Dust and dirt under a spot: places that are dark now and were not when the target was calibrated.

A speck is opaque and has an edge. The target's print and surface texture are known and a drift of the camera
only moves them; the laser's power, the exposure time and smears without an edge change all of a spot alike.
Specks are thus the places where the light's fine structure, after division by the texture at its best shift,
is far darker than the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from altd.statistics import MAD_TO_SIGMA
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.image import Image
from altd.vision.texture import MAX_SHIFT_PX, Texture, TextureSample, match, sample_of

_MIN_LOSS = 0.4
"""Minimum loss as a share of a pixel's light. The error of a print's model at the edges of its dots is
smaller, and so is that by an image that moved by a fraction of a pixel."""
_LOSS_SIGMAS = 5.0
"""Minimum loss per sigma of the pixel's noise, and of most pixels' scatter: coarse texture is no dust."""
_MAX_NOISE = 0.1
"""Maximum noise of a pixel's light; noisier pixels, on the flanks of a spot, are skipped."""
_MIN_EXPECTED = 0.7
"""Minimum share of the surrounding light; pixels that show less, in the gaps of a print, are skipped."""
_MIN_TOGETHER = 2.0
"""Minimum number of dark pixels among nine neighbouring ones: blurred by the lens, none is dark alone."""
_MIN_PIXELS = 100
_DARKEST = 0.01
_MAX_TEXTURE_CONTRAST = 0.2
"""Contrast of a target's texture from which it is printed (``fingerprint``)."""


@dataclass(frozen=True, slots=True)
class DustCount:
    """Number of covered pixels under a spot, and number of pixels that were examined."""

    covered: int
    looked_at: int


def count_dust(analysis: FrameAnalysis, texture: Texture) -> DustCount | None:
    """Count dust over the brightest spot of a frame; None if it is clipped or too little is visible or known.

    A pixel is covered if 40 % of its light are missing. Takes about a millisecond.
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


def _expected(sample: TextureSample, texture: Texture) -> Image | None:
    """Return each pixel's light expected from the calibration, relative to its surroundings; None: not known.

    If nothing matches, a plate counts as even: its surface texture is no dust, but print would be.
    """
    found = match(sample, texture)
    if found is None:
        return np.ones_like(sample.relative) if texture.contrast < _MAX_TEXTURE_CONTRAST else None
    shift = np.array([[1.0, 0.0, MAX_SHIFT_PX - found.u_px], [0.0, 1.0, MAX_SHIFT_PX - found.v_px]])
    rows, columns = sample.relative.shape
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    moved = cv2.warpAffine(texture.around(sample), shift, (columns, rows), flags=flags)
    gain = min(max(found.gain, 0.0), 1.0)
    return np.asarray(np.maximum(1 + gain * moved, _DARKEST), dtype=np.float32)
