"""From the numbers that cameras give their frames to numbers that only grow."""

from __future__ import annotations


class FrameCounter:
    """Counts a camera's exposures, those too that were lost, over wraps and re-openings.

    A camera's own numbers run from ``first`` to ``last`` and then begin with ``first`` again: 0 to 2³² − 1
    in Video4Linux, 1 to 65535 in GigE Vision, where 0 means that a frame has no number. A number that is not
    ahead of the last one by less than half of that range was counted from zero again, or not at all: then the
    frame takes the next number. It does so after a re-opening too: how many were lost meanwhile is unknown.
    """

    def __init__(self, first: int, last: int) -> None:
        self._numbers = range(first, last + 1)
        self._last_raw: int | None = None
        self._last = -1

    def reopened(self) -> None:
        """The camera's numbers start again; ours continue."""
        self._last_raw = None

    def number(self, raw: int) -> int:
        """Our number of the frame that the camera calls ``raw``; the first one is 0."""
        ahead = 1
        if self._last_raw is not None and raw in self._numbers:
            distance = (raw - self._last_raw) % len(self._numbers)
            if 0 < distance < len(self._numbers) / 2:
                ahead = distance
        self._last_raw = raw if raw in self._numbers else None
        self._last += ahead
        return self._last
