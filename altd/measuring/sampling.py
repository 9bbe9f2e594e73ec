"""Whether the times of the exposures let a vibration at a multiple of the frame rate look like rest.

The mean of a window errs by the vibration's amplitude times |mean exp(2πi k t/T)| over its exposures. For
independent phases its square is 1/n on average, as the scatter of n exposures shows; for even ones it is 1.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from enum import StrEnum

import cv2
import numpy as np

from altd.measuring.motion_memory import MEMORY_S
from altd.records import FloatArray, MeanSpots

_GROUP_FRAME_SETS = 20
_MIN_GROUPS, _MAX_GROUPS = 5, 10
_MULTIPLES = np.arange(1, 7)
"""Multiples of the rate that are examined; an exposure of some ms averages over higher ones."""
_MAX_EXCESS = 4.0
"""Maximum of n |mean exp|²: above it the error is more than twice what the scatter shows."""
_STEPS = 2j * np.pi * np.array([[0.4], [0.025]])
_COARSE, _FINE = np.arange(2, 16)[:, None], np.arange(4, 20)[:, None]
"""Frequencies, per mean rate, at which the phases of a window are compared: sums of a number of coarse steps
and one of fine steps, from 0.9 to 6.475, two in the width of a line."""
_USUAL_EXCESS = 6.5
"""Of the worst of these frequencies in an uneven window of 20; few windows exceed it."""
_UNEVEN_BY = 0.08
"""Mean distance of the intervals from multiples of the usual one, above which they are uneven before this is
known: 0.25 of software triggers, 0.03 of a crystal with a jitter of a tenth of the period."""
MIN_EXPOSURES = 18
"""Number of exposures at uneven times below which a mean may err by twenty times what they show."""
_HIDING_EXPOSURES = 9.0
"""Number of exposures whose phases may all be close together by chance."""


class Sampling(StrEnum):
    """Regularity of the exposures."""

    EVEN = "even"
    """A vibration near a multiple of the frame rate does not show in the scatter."""
    UNEVEN = "uneven"
    """Each vibration shows in the scatter, and is in sigma."""


class SamplingCheck:
    """Finds out from the times of the last frame sets; ``found`` is None until 100 are known."""

    def __init__(self) -> None:
        self._times_ns: deque[int] = deque(maxlen=_MAX_GROUPS * _GROUP_FRAME_SETS)
        self._since_check = 0
        self._period_ns = 1.0
        """Median interval, when it was last needed."""
        self.found: Sampling | None = None

    def add(self, t_ns: int) -> None:
        """Add the time of a frame set."""
        self._times_ns.append(t_ns)
        self._since_check += 1
        if self._since_check >= _GROUP_FRAME_SETS and len(self._times_ns) >= _MIN_GROUPS * _GROUP_FRAME_SETS:
            self._since_check = 0
            self.found = self._judged()

    def excess(self, frames: int) -> float:
        """Return n |mean exp(2πi f t/T)|² of the last n frame sets at the worst frequency; 0: even times."""
        if self.found is Sampling.EVEN or len(self._times_ns) <= 1:
            return 0.0
        if self.found is None:
            intervals = np.diff(self._periods())
            if np.abs(intervals - np.round(intervals)).mean() < _UNEVEN_BY:
                return 0.0
        last = np.array(list(self._times_ns)[-frames:], dtype=np.float64)
        last = (last - last[0]) / self._period_ns
        # Products of powers of two factors take a sixth of the time of an exponential for each frequency.
        coarse, fine = np.exp(_STEPS * last)
        sums = coarse**_COARSE @ (fine**_FINE).T
        return float(np.abs(sums).max() ** 2 / len(last))

    def _periods(self) -> FloatArray:
        """Return the times since the first one, in median intervals."""
        times_ns = np.array(self._times_ns, dtype=np.float64)
        self._period_ns = float(np.median(np.diff(times_ns)))
        return np.asarray((times_ns - times_ns[0]) / self._period_ns)

    def _judged(self) -> Sampling:
        """Return whether n |mean exp(2πi k t/T)|² is small at all multiples k, T the median interval."""
        periods = self._periods()
        groups = periods[: len(periods) // _GROUP_FRAME_SETS * _GROUP_FRAME_SETS]
        groups = groups.reshape(-1, _GROUP_FRAME_SETS)
        means = np.exp(2j * np.pi * _MULTIPLES[:, None, None] * groups).mean(axis=2)
        excess = _GROUP_FRAME_SETS * float(np.square(np.abs(means)).mean(axis=1).max())
        return Sampling.EVEN if excess > _MAX_EXCESS else Sampling.UNEVEN


class ScatterMemory:
    """The scatter of single exposures, averaged over those of the last seconds.

    At uneven times the phases of a vibration are random. Where those of a window are close together by
    chance, its mean errs most, and its own scatter is smallest.
    """

    def __init__(self) -> None:
        self._scatter_px2: FloatArray | None = None
        self._exposures = 0.0
        """Number of exposures remembered, each with a weight that decreases with its age."""
        self._newest_ns = 0

    @property
    def _known_share(self) -> float:
        """Share of the scatter that few exposures show if their phases are close together by chance."""
        return 1.0 - _HIDING_EXPOSURES / self._exposures

    @property
    def scatter_px(self) -> FloatArray | None:
        """Largest likely standard deviation of exposures at uneven times, (2 · targets,); None: not known."""
        if self._scatter_px2 is None or self._exposures <= _HIDING_EXPOSURES:
            return None
        return np.asarray(np.sqrt(np.diag(self._scatter_px2) / self._known_share))

    def widened(self, mean: MeanSpots, excess: float) -> MeanSpots | None:
        """Return the mean spots of uneven times with at least the average scatter in each direction.

        ``excess`` is that of the window (``SamplingCheck``): beyond the usual one the scatter counts more, so
        that a vibration at the worst frequency errs by less than four sigma. The fewer exposures are
        remembered, the earlier it does. None: too few for a sigma.
        """
        motion = mean.motion
        if motion is None:
            return mean
        of_window_px2 = motion.rate_covariance * (motion.spread_s2 * mean.frames)
        newest_ns = mean.t_ns + round(motion.newest_s * 1e9)
        since_s, self._newest_ns = abs(newest_ns - self._newest_ns) * 1e-9, newest_ns
        new = mean.frames * min(since_s / motion.span_s, 1.0)
        self._exposures = self._exposures * math.exp(-since_s / MEMORY_S) + new
        scatter_px2 = of_window_px2 if self._scatter_px2 is None else self._scatter_px2
        if self._exposures >= mean.frames + 2:
            scatter_px2 = scatter_px2 + new / self._exposures * (of_window_px2 - scatter_px2)
        elif np.trace(of_window_px2) > np.trace(scatter_px2):
            scatter_px2 = of_window_px2  # of all exposures so far
        self._scatter_px2 = scatter_px2
        if self._exposures < MIN_EXPOSURES:
            return None
        usual = _USUAL_EXCESS * self._known_share
        expected_px2 = scatter_px2 * max(excess / usual, 1.0)
        _, variances_px2, axes = cv2.eigen(expected_px2 - of_window_px2)  # in a third of numpy's time
        more_px2 = axes.T @ (np.maximum(variances_px2, 0.0) * axes)
        of_mean_px2 = more_px2 / mean.frames
        return replace(
            mean,
            covariance_px2=mean.covariance_px2 + of_mean_px2,
            motion=replace(
                motion,
                rate_covariance=motion.rate_covariance + of_mean_px2 / motion.spread_s2,
                vibration_px2=motion.vibration_px2 + more_px2,
            ),
        )
