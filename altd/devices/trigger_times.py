"""Instants of software triggers: uneven, and the same for all cameras of this computer.

Frames at a constant rate show a vibration at a multiple of the rate as rest. Here the intervals of 64 frames
lie from half a period to one and a half, in random order. With an even distribution the mean of exp(2πi f t)
over an interval is zero at every multiple of the rate: a vibration there has an independent phase in each
frame, the mean of a window is unbiased, and the frames scatter as it is uncertain (additive random sampling:
Shapiro and Silverman, J. SIAM 8, 225, 1960). Between the multiples neighbouring phases remain correlated; the
distribution is slightly curved to limit that.
"""

from __future__ import annotations

import math
import random
from bisect import bisect_right
from functools import lru_cache
from itertools import accumulate

BLOCK_FRAMES = 64
"""Number of frames after which the instants are at a multiple of the period again."""
_SHAPE = (-0.02, -0.01)
"""Of the distribution: the error of 20 frames at any frequency above the rate is at most 1.13 times that of
independent phases, with an even one 1.23 times (at 1.5 times the rate)."""


class TriggerTimes:
    """A function of the monotonic clock, the period and the shortest interval, without further state.

    Cameras that share it are triggered together, whenever each was opened. ``shortest_ns`` is the time from
    one trigger to the next that each camera needs; above half the period the intervals vary less.
    """

    def __init__(self, period_ns: int, shortest_ns: int) -> None:
        self._period_ns = period_ns
        self._shortest_ns = 0
        self.lengthen(shortest_ns)

    def lengthen(self, shortest_ns: int) -> None:
        """Lengthen the shortest interval to what a camera needs; from half a period to one."""
        self._shortest_ns = min(max(self._shortest_ns, shortest_ns, self._period_ns // 2), self._period_ns)

    def after(self, t_ns: int) -> int:
        """Return the first instant after a time of the monotonic clock, ns."""
        block, within_ns = divmod(t_ns, BLOCK_FRAMES * self._period_ns)
        instants_ns = _instants_ns(block, self._period_ns, self._shortest_ns)
        return block * BLOCK_FRAMES * self._period_ns + instants_ns[bisect_right(instants_ns, within_ns)]


@lru_cache(maxsize=4)
def _instants_ns(block: int, period_ns: int, shortest_ns: int) -> tuple[int, ...]:
    """Return the instants of a block from its begin; the last one is its end."""
    even = [(n + 0.5) / BLOCK_FRAMES - 0.5 for n in range(BLOCK_FRAMES)]
    shaped = [u + sum(a * math.sin(2 * k * math.pi * u) for k, a in enumerate(_SHAPE, 1)) for u in even]
    intervals_ns = [period_ns + round(2 * (period_ns - shortest_ns) * deviation) for deviation in shaped]
    random.Random(block).shuffle(intervals_ns)  # noqa: S311  not for secrets
    return tuple(accumulate(intervals_ns))
