"""Regular times of a camera's exposures, from stamps with jitter."""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from statistics import median

RESTART_GAP_NS = 500_000_000
"""Time without a frame after which a camera may have been restarted."""
_MEMORY_FRAMES = 64
_MIN_FRAMES = 16
"""Number of frames from which the line is known."""
_MAX_JITTER_PERIODS = 0.2
"""Jitter above which exposures are irregular, as those of uneven triggers."""
_GOOD_JITTERS = 6.0
"""Distance of a good stamp from the line, also if frames arrive in bursts (exponential delays)."""
_MARGIN_JITTERS = 4.0
"""Distance of a good stamp from the place of a frame that is a period off."""
_MOVED_FRAMES = 3
"""Number of frames in a row equally far from the line after which it moves there. Old frames that are stamped
at their common arrival are not equally far from it."""
_CROWDED_PERIODS = 0.3
"""Distance of two stamps, in mean periods, below which they are not those of two exposures. The intervals of
uneven triggers vary from half to one and a half."""
_MAX_CROWDED = 0.25
"""Share of such stamps above which a line may be through late ones: of bursts of two every second is late."""
_CHANGED_FRAMES = 12
"""Number of frames in a row off the line after which it begins again, as after a change of the rate. More
than a camera's queue holds in usual stalls."""


class Stamp(Enum):
    """Relation of a frame's stamp to those of its camera's other frames."""

    ON_LINE = "near the line through them"
    OFF_LINE = "not near it"
    ALONE = "no line is known, or the exposures are irregular"
    CROWDED = "frames are stamped as they arrive in bursts: often, or while no line is known"


class RegularTimes:
    """Line through the stamps of a free-running camera by its frames' numbers.

    Its exposures are regular even if its stamps are not. The line is a least-squares fit with expanding, then
    fading memory (Brookner, Tracking and Kalman Filtering Made Easy, 1.2.10). A lost frame that was not
    counted, a late frame and a step of the clock are off the line.
    """

    def __init__(self) -> None:
        self._frames = 0
        """Number of frames in the fit, up to ``_MEMORY_FRAMES``."""
        self._number = 0
        self._line_ns = 0
        """Time on the line of frame ``_number``."""
        self._period_ns = 0.0
        self._variance_ns2 = 0.0
        self._off_ns: deque[int] = deque(maxlen=_CHANGED_FRAMES)
        """Distances of the last frames from the line if they are off it."""
        self._last_ns = 0
        self._gaps_ns: deque[int] = deque(maxlen=_MEMORY_FRAMES)
        """Distances of the last frames' stamps, each from the one before."""

    def add(self, number: int, t_ns: int) -> tuple[int, Stamp]:
        """Return a frame's time on the line, and its stamp's relation to it.

        While the line is not known, or the exposures are irregular, the time is the stamp.
        """
        gap_ns, self._last_ns = t_ns - self._last_ns, t_ns
        if self._frames and 0 <= gap_ns <= RESTART_GAP_NS:
            self._gaps_ns.append(gap_ns)
        steps = number - self._number
        is_known = self._frames >= _MIN_FRAMES
        line_ns = self._line_ns + round(self._period_ns * steps)
        off_ns = t_ns - line_ns
        is_counted = steps > 0 and abs(off_ns) <= self._period_ns
        is_restarted = t_ns - self._line_ns > RESTART_GAP_NS and (is_counted or steps <= 0)
        has_changed = len(self._off_ns) == _CHANGED_FRAMES
        if is_restarted or has_changed or not self._frames or (steps <= 0 and not is_known):
            self._begin(number, t_ns)
            return t_ns, self._without_line()
        jitter_ns = math.sqrt(self._variance_ns2)
        if not is_known or (steps > 0 and abs(off_ns) <= self._period_ns / 2):
            line_ns = self._fit(number, steps, line_ns, off_ns)
        else:
            line_ns = self._moved(number, line_ns, off_ns)
        if not is_known or jitter_ns > _MAX_JITTER_PERIODS * self._period_ns:
            return t_ns, self._without_line()
        if self._crowded() > _MAX_CROWDED:
            return line_ns, Stamp.CROWDED
        near_ns = min(_GOOD_JITTERS * jitter_ns, self._period_ns - _MARGIN_JITTERS * jitter_ns)
        return line_ns, Stamp.ON_LINE if abs(off_ns) <= near_ns else Stamp.OFF_LINE

    def _without_line(self) -> Stamp:
        return Stamp.CROWDED if self._crowded() else Stamp.ALONE

    def _crowded(self) -> float:
        """Return the share of the last gaps that are too small between exposures."""
        gaps_ns = self._gaps_ns
        small_ns = _CROWDED_PERIODS * sum(gaps_ns) / max(len(gaps_ns), 1)
        return sum(gap_ns < small_ns for gap_ns in gaps_ns) / max(len(gaps_ns), 1)

    def _begin(self, number: int, t_ns: int) -> None:
        self._frames, self._number, self._line_ns = 1, number, t_ns
        self._period_ns = self._variance_ns2 = 0.0
        self._off_ns.clear()

    def _fit(self, number: int, steps: int, line_ns: int, off_ns: int) -> int:
        """Add a frame to the fit; return its time on the line."""
        before = self._frames
        n = self._frames = min(before + 1, _MEMORY_FRAMES)
        if before > 2:
            # Of the next stamp about a line through so many, per variance of a stamp.
            expected = 1.0 + 2.0 * (2 * before + 1) / (before * (before - 1))
            self._variance_ns2 += (off_ns**2 / expected - self._variance_ns2) / (n - 2)
        self._number = number
        self._line_ns = line_ns + round(off_ns * 2 * (2 * n - 1) / (n * (n + 1)))
        self._period_ns += off_ns * 6 / (n * (n + 1)) / steps
        self._off_ns.clear()
        return self._line_ns

    def _moved(self, number: int, line_ns: int, off_ns: int) -> int:
        """Count a frame off the line; return its time on the line, which moves if others are as far off."""
        self._off_ns.append(off_ns)
        last_ns = list(self._off_ns)[-_MOVED_FRAMES:]
        if len(last_ns) < _MOVED_FRAMES or max(last_ns) - min(last_ns) > self._period_ns / 2:
            return line_ns
        self._number, self._line_ns = number, line_ns + round(median(last_ns))
        self._frames = _MIN_FRAMES
        self._off_ns.clear()
        return self._line_ns
