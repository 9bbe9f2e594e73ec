"""Fingerprints of a unit's cameras, from the frames of its calibration."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from altd.calibration.target_frames import FrameRow
from altd.records import FloatArray, Spot
from altd.vision.fingerprint import Fingerprint, ViewOutcome
from altd.vision.flat import Flat
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.hot_pixels import HotPixelCount
from altd.vision.localise import locate_in
from altd.vision.settings import SpotSettings
from altd.vision.texture import Texture, TextureSample, sample_of

_MAX_SIGMA = 0.05
"""Maximum relative noise of a pixel whose texture is known: that of a plain plate's grain."""
_DOUBLED_QUANTILE = 0.95
_MIN_VERIFIED_SHARE = 0.9
"""Minimum share of a scan's nodes that its flat verifies; below, the flat is not what the laser shows."""


def fingerprint_of(
    frames: Iterable[FrameRow], settings: SpotSettings, flat: Flat | None, plain: bool
) -> tuple[Fingerprint, str | None]:
    """Compute one camera's fingerprint from its ``frames`` of a scan, and a doubt, None without one.

    The texture is that of the target's ``flat`` if the scan's own spots agree with it. Without a flat, it is
    computed from the spots of a ``plain`` target. A print without a model has no usable texture.
    """
    hot = HotPixelCount()
    ground = _Ground()
    first: dict[tuple[float, float], FrameRow] = {}
    for frame_row in frames:
        row, frame = frame_row.row, frame_row.frame()
        hot.add(frame.pixels)
        if row.leds_on:
            continue
        if row.position_mm is not None:
            first.setdefault(row.position_mm, frame_row)
        if flat is None and plain and (sample := sample_of(FrameAnalysis(frame, settings))) is not None:
            ground.add(sample, frame.pixels.shape)
    if flat is None:
        texture = ground.texture()
        return Fingerprint(hot.result(), texture, None if texture is None else "scan"), None
    made = Fingerprint(hot.result(), Texture.of_flat(flat), "flat")
    verdicts = []
    for frame_row in first.values():
        analysis = FrameAnalysis(frame_row.frame(), settings)
        if isinstance(locate_in(analysis, flat), Spot):
            verdicts.append(made.examine(analysis, has_spot=True))
    good = sum(verdict.outcome is ViewOutcome.VERIFIED for verdict in verdicts)
    if good >= _MIN_VERIFIED_SHARE * len(verdicts):
        doubled_px = [verdict.doubled_px for verdict in verdicts if verdict.doubled_px is not None]
        usual_px = float(np.quantile(doubled_px, _DOUBLED_QUANTILE)) if doubled_px else None
        return replace(made, usual_doubled_px=usual_px), None
    doubt = f"the flat does not show the spots' ground ({good} of {len(verdicts)} nodes): it verifies no view"
    return Fingerprint(hot.result(), None, None), doubt


def hot_pixels_of(frames: Iterable[FrameRow]) -> Fingerprint:
    """Compute the fingerprint of a camera without laser spots in its frames: its hot pixels."""
    hot = HotPixelCount()
    for frame_row in frames:
        hot.add(frame_row.frame().pixels)
    return Fingerprint(hot.result(), None, None)


class _Ground:
    """Texture of a plain target: mean of samples, weighted by the inverse of their variance."""

    def __init__(self) -> None:
        self._total: FloatArray = np.empty((0, 0))
        self._weight: FloatArray = np.empty((0, 0))

    def add(self, sample: TextureSample, shape: tuple[int, ...]) -> None:
        """Add a sample of a frame of this shape."""
        if not self._total.size:
            self._total, self._weight = np.zeros(shape), np.zeros(shape)
        rows, columns = sample.relative.shape
        window = slice(sample.top, sample.top + rows), slice(sample.left, sample.left + columns)
        self._total[window] += sample.relative / sample.variance
        self._weight[window] += 1 / sample.variance

    def texture(self) -> Texture | None:
        """Return the mean, shrunk towards 0 where it is uncertain; None without samples."""
        if not self._total.size:
            return None
        known = self._weight > _MAX_SIGMA**-2
        variance = 1 / np.maximum(self._weight, 1e-12)
        mean = self._total * variance
        power = max(float(np.mean(np.square(mean[known]) - variance[known])), 0.0) if known.any() else 0.0
        return Texture((mean * power / (power + variance)).astype(np.float32))
