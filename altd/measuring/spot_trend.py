"""Changes of a target's spots: light and residual of the fit over hours, and sudden growth of the residual.

An ageing laser, a window that gathers dust and a target that gets dirty appear here long before a spot is
rejected as too dim or ``distorted``.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from altd.reasons import Reason
from altd.records import NoSpot, Spot
from altd.statistics import median
from altd.vision.dust import DustCount
from altd.vision.localise import MIN_DISTORTION_DIAMETERS

BUCKET_NS = 60 * 10**9
"""Duration of one point of a trend: the median of a minute."""

_SAMPLE_INTERVAL_NS = 10**9
"""Minimum time between samples: spots within one second are alike."""

_MIN_SAMPLES = 20
"""Minimum number of spots in a minute; with fewer the beam was being aimed, and the minute does not count."""

REFERENCE_BUCKETS = 30
RECENT_BUCKETS = 10
"""Numbers of minutes: the first ones' median is the reference, the last ones' the current value."""

_DUST_COUNTS = 120
"""Maximum number of counts kept: ten minutes, at one every five seconds."""


def residual_share(spot: Spot) -> float:
    """Return the residual of a spot's fit, as a share of the limit of ``distorted``.

    It is based on ``excess_px``, the possible displacement of the spot by unexplained light, one sigma.
    """
    return spot.excess_px / (MIN_DISTORTION_DIAMETERS * spot.diameter_px)


_BEFORE, _AFTER = 6, 4
"""Numbers of exposures before and after a step."""
_STEP = 0.4
"""Minimum step of the residual from one exposure to the next, as a share of the limit of ``distorted``. Dust
of simulated dusty units, which the beam drives over, makes steps of up to 0.26."""
_MAX_JUMP_DIAMETERS = 0.05
"""Maximum motion of a spot between two exposures, beyond which it may reach other dust."""


class SuddenResidual:
    """Rejects the spots of one target after its residual has grown suddenly.

    Dust grows in hours, or while the beam moves. A splash or another light comes from one exposure to the
    next, and may displace the spot by more than the residual shows. The spots are rejected until the residual
    is as before, or the beam jumps.
    """

    def __init__(self) -> None:
        self._shares: deque[float] = deque(maxlen=_BEFORE + _AFTER)
        self._usual: float | None = None
        """Residual before the step; None: there was none."""
        self._last: Spot | None = None

    def checked(self, spot: Spot | NoSpot) -> Spot | NoSpot:
        """Return the spot of the next exposure, or why it is rejected."""
        if isinstance(spot, NoSpot):
            self._shares.clear()
            return spot
        last, self._last = self._last or spot, spot
        moved_px = math.hypot(spot.u_px - last.u_px, spot.v_px - last.v_px)
        if moved_px > _MAX_JUMP_DIAMETERS * spot.diameter_px:
            self._shares, self._usual = deque(maxlen=_BEFORE + _AFTER), None
        self._shares.append(residual_share(spot))
        shares = list(self._shares)
        if self._usual is not None:
            if len(shares) >= _AFTER and max(shares[-_AFTER:]) < self._usual + _STEP / 2:
                self._usual = None
        elif len(shares) == _BEFORE + _AFTER and shares[_BEFORE] - shares[_BEFORE - 1] > _STEP:
            before, after = shares[:_BEFORE], shares[_BEFORE:]
            scatter = max(max(part) - min(part) for part in (before, after))
            if min(after) - max(before) > _STEP and scatter < _STEP / 2:  # turbulent air scatters more
                self._usual = max(before)
        if self._usual is None:
            return spot
        return NoSpot(Reason.DISTORTED, "other light or a film has come over it suddenly")


@dataclass(frozen=True, slots=True)
class TrendFigures:
    """Reference and current value of a trend, in the unit of its samples; None: not known yet."""

    reference: float | None
    recent: float | None

    @property
    def share(self) -> float | None:
        """Current value over the reference; None: not known."""
        if self.reference is None or self.recent is None or self.reference <= 0:
            return None
        return self.recent / self.reference


class MedianTrend:
    """Medians of minutes, by the time of the frames: bounded memory, and outliers have no effect.

    ``reference`` is kept indefinitely once it is known. A minute with too few values does not count, so
    switching the beam off for the night changes nothing.
    """

    def __init__(self, reference: float | None = None) -> None:
        self.figures = TrendFigures(reference, None)
        """Figures from the completed minutes."""
        self._first: list[float] = []
        self._recent: deque[float] = deque(maxlen=RECENT_BUCKETS)
        self._samples: list[float] = []
        self._bucket: int | None = None
        self._sampled_ns: int | None = None

    def add(self, t_ns: int, value: float) -> None:
        """Add a sample taken at that time; values that are not finite are ignored."""
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
    """Share of the area under a target's spots that is covered, over the last ten minutes with a beam.

    The share is that of all pixels together and not a median: a moving beam meets a speck only now and then,
    each time one of the same.
    """

    def __init__(self) -> None:
        self._counts: deque[DustCount] = deque(maxlen=_DUST_COUNTS)
        self.share: float | None = None
        """Covered share; None before five minutes of counts."""

    def add(self, count: DustCount) -> None:
        """Add the count of covered pixels under one spot."""
        self._counts.append(count)
        if len(self._counts) >= _DUST_COUNTS // 2:
            covered = sum(count.covered for count in self._counts)
            self.share = covered / sum(count.looked_at for count in self._counts)


def _median(values: list[float] | deque[float]) -> float:
    return float(median(np.array(values)))
