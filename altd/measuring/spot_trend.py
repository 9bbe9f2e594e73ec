"""Changes of a target's spots over hours: their light and the residual of their fit; pure numbers.

A laser that ages, a window that gathers dust and a target that gets dirty show here long before a spot is
refused as too dim or ``distorted``.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from altd.records import Spot
from altd.statistics import median
from altd.vision.dust import DustCount
from altd.vision.localise import MIN_DISTORTION_DIAMETERS

BUCKET_NS = 60 * 10**9
"""A minute's median is one point of a trend."""

_SAMPLE_INTERVAL_NS = 10**9
"""Spots of one second are alike: one of them is enough."""

_MIN_SAMPLES = 20
"""A minute with fewer spots than this says too little: the beam was being aimed."""

REFERENCE_BUCKETS = 30
RECENT_BUCKETS = 10
"""The reference is the median of the first so many minutes, what is now that of the last so many."""

_DUST_COUNTS = 120
"""Ten minutes of counts, one every five seconds."""


def residual_share(spot: Spot) -> float:
    """The residual of a spot's fit, as a share of the limit of ``distorted``.

    Of ``excess_px``: what unexplained light may displace the spot by, one sigma.
    """
    return spot.excess_px / (MIN_DISTORTION_DIAMETERS * spot.diameter_px)


@dataclass(frozen=True, slots=True)
class TrendFigures:
    """A trend's reference and what it is now, in the unit of its samples; None: not known yet."""

    reference: float | None
    recent: float | None

    @property
    def share(self) -> float | None:
        """The current value over the reference; None: not known."""
        if self.reference is None or self.recent is None or self.reference <= 0:
            return None
        return self.recent / self.reference


class Trend:
    """Medians of minutes, by the time of the frames: bounded memory, and no outlier counts.

    ``reference`` is kept indefinitely once it is known. A minute with too few values does not count, so a
    beam that is switched off for the night changes nothing.
    """

    def __init__(self, reference: float | None = None) -> None:
        self.figures = TrendFigures(reference, None)
        """By the completed minutes."""
        self._first: list[float] = []
        self._recent: deque[float] = deque(maxlen=RECENT_BUCKETS)
        self._samples: list[float] = []
        self._bucket: int | None = None
        self._sampled_ns: int | None = None

    def add(self, t_ns: int, value: float) -> None:
        """Take a sample of that instant; values that are not finite are none."""
        if not math.isfinite(value):
            return
        if self._sampled_ns is not None and 0 <= t_ns - self._sampled_ns < _SAMPLE_INTERVAL_NS:
            return
        self._sampled_ns = t_ns
        bucket = t_ns // BUCKET_NS
        if bucket != self._bucket:
            self._close()
            self._bucket = bucket
        self._samples.append(value)

    def _close(self) -> None:
        if len(self._samples) >= _MIN_SAMPLES:
            point = _median(self._samples)
            self._recent.append(point)
            reference = self.figures.reference
            if reference is None:
                self._first.append(point)
                if len(self._first) == REFERENCE_BUCKETS:
                    reference = _median(self._first)
                    self._first.clear()
            recent = _median(self._recent) if len(self._recent) == RECENT_BUCKETS else None
            self.figures = TrendFigures(reference, recent)
        self._samples.clear()


class DustShare:
    """The share of the area under a target's spots that is covered, over the last ten minutes with a beam.

    Of all pixels together and no median: a beam that moves meets a speck now and then, each time one of the
    same.
    """

    def __init__(self) -> None:
        self._counts: deque[DustCount] = deque(maxlen=_DUST_COUNTS)
        self.share: float | None = None
        """The share; None before five minutes of counts."""

    def add(self, count: DustCount) -> None:
        """Take what covers one spot."""
        self._counts.append(count)
        if len(self._counts) >= _DUST_COUNTS // 2:
            covered = sum(count.covered for count in self._counts)
            self.share = covered / sum(count.looked_at for count in self._counts)


def _median(values: list[float] | deque[float]) -> float:
    return float(median(np.array(values)))
