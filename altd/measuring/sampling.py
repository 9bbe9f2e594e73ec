"""Whether the times of the exposures let a vibration at a multiple of the frame rate look like rest.

The mean of a window errs by the vibration's amplitude times |mean exp(2πi k t/T)| over its exposures. For
independent phases its square is 1/n on average, as the scatter of n exposures shows; for even ones it is 1.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from altd.measuring.motion_memory import MEMORY_S
from altd.records import FloatArray, MeanSpots

_GROUP_FRAME_SETS = 20
_MIN_GROUPS, _MAX_GROUPS = 5, 10
_MULTIPLES = np.arange(1, 7)
"""Multiples of the rate that are examined; an exposure of some ms averages over higher ones."""
_MAX_EXCESS = 4.0
"""Maximum of n |mean exp|²: above it the error is more than twice what the scatter shows."""
_FREQUENCIES = np.arange(0.9, 6.5, 0.025)
"""Frequencies, per mean rate, at which the phases of a window are compared: two in the width of a line."""
_USUAL_EXCESS = 6.5
"""Of the worst of these frequencies in an uneven window of 20; few windows exceed it."""


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
        self._first_ns, self._period_ns = 0, 1.0
        self._phasors: deque[npt.NDArray[np.complex128]] = deque(maxlen=_MAX_GROUPS * _GROUP_FRAME_SETS)
        """Of the frame sets at uneven times, exp(2πi f t/T) at the frequencies."""
        self.found: Sampling | None = None

    def add(self, t_ns: int) -> None:
        """Add the time of a frame set."""
        self._times_ns.append(t_ns)
        self._since_check += 1
        if self._since_check >= _GROUP_FRAME_SETS and len(self._times_ns) >= _MIN_GROUPS * _GROUP_FRAME_SETS:
            self._since_check = 0
            before, self.found = self.found, self._judged()
            if self.found is not before:
                self._phasors.clear()
                self._first_ns, self._period_ns = t_ns, float(np.median(np.diff(self._times_ns)))
        if self.found is Sampling.UNEVEN:
            turns = _FREQUENCIES * ((t_ns - self._first_ns) / self._period_ns)
            self._phasors.append(np.exp(2j * np.pi * turns))

    def excess(self, frames: int) -> float:
        """Return n |mean exp(2πi f t/T)|² of the last n frame sets at the worst frequency; 0: not known."""
        last = list(self._phasors)[-frames:]
        if not last:
            return 0.0
        return float(np.square(np.abs(np.add.reduce(last))).max()) / len(last)

    def _judged(self) -> Sampling:
        """Return whether n |mean exp(2πi k t/T)|² is small at all multiples k, T the median interval."""
        times_ns = np.array(self._times_ns, dtype=np.float64)
        periods = (times_ns - times_ns[0]) / np.median(np.diff(times_ns))
        groups = periods[: len(periods) // _GROUP_FRAME_SETS * _GROUP_FRAME_SETS]
        groups = groups.reshape(-1, _GROUP_FRAME_SETS)
        means = np.exp(2j * np.pi * _MULTIPLES[:, None, None] * groups).mean(axis=2)
        excess = _GROUP_FRAME_SETS * float(np.square(np.abs(means)).mean(axis=1).max())
        return Sampling.EVEN if excess > _MAX_EXCESS else Sampling.UNEVEN


class ScatterMemory:
    """The scatter of single exposures, averaged over the windows of the last seconds.

    At uneven times the phases of a vibration are random. Where those of a window are close together by
    chance, its mean errs most, and its own scatter is smallest.
    """

    def __init__(self) -> None:
        self._scatter_px2: FloatArray | None = None
        self._t_ns = 0

    @property
    def scatter_px(self) -> FloatArray | None:
        """Average standard deviation of single exposures at uneven times, (2 · targets,); None: not known."""
        return None if self._scatter_px2 is None else np.sqrt(np.diag(self._scatter_px2))

    def widened(self, mean: MeanSpots, excess: float) -> MeanSpots:
        """Return the mean spots of uneven times with at least the average scatter in each direction.

        ``excess`` is that of the window (``SamplingCheck``): beyond the usual one the scatter counts more, so
        that a vibration at the worst frequency errs by less than four sigma.
        """
        motion = mean.motion
        if motion is None:
            return mean
        of_window_px2 = motion.rate_covariance * motion.spread_s2 * mean.frames
        if self._scatter_px2 is None:
            self._scatter_px2 = of_window_px2
        kept = math.exp(-max(mean.t_ns - self._t_ns, 0) * 1e-9 / MEMORY_S)
        self._t_ns = mean.t_ns
        self._scatter_px2 = kept * self._scatter_px2 + (1.0 - kept) * of_window_px2
        expected_px2 = self._scatter_px2 * max(excess / _USUAL_EXCESS, 1.0)
        variances, axes = np.linalg.eigh(expected_px2 - of_window_px2)
        more_px2 = axes * np.maximum(variances, 0.0) @ axes.T
        return replace(
            mean,
            is_even=False,
            covariance_px2=mean.covariance_px2 + more_px2 / mean.frames,
            motion=replace(
                motion,
                rate_covariance=motion.rate_covariance + more_px2 / (motion.spread_s2 * mean.frames),
                vibration_px2=motion.vibration_px2 + more_px2,
            ),
        )
