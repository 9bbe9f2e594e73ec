"""Conversion of the cameras' frame numbers to numbers that only increase."""

from __future__ import annotations


class FrameCounter:
    """Counts a camera's exposures, including lost ones, across wraps and re-openings.

    A camera's own numbers run from ``first`` to ``last`` and then restart at ``first``: 0 to 2³² − 1 in
    Video4Linux, 1 to 65535 in GigE Vision, where 0 means that a frame has no number. A number that is not
    ahead of the last one by less than half of that range is from a restarted counter, or is no count: the
    frame then takes the next number. So does the first frame after a re-opening, because the number of lost
    frames is unknown.
    """

    def __init__(self, first: int, last: int) -> None:
        self._numbers = range(first, last + 1)
        self._last_raw: int | None = None
        self._last = -1

    def reopened(self) -> None:
        """Note that the camera's numbers restart; the counter's own numbers continue."""
        self._last_raw = None

    def number(self, raw: int) -> int:
        """Return the counter's number for the camera's frame number ``raw``; the first one is 0."""
        ahead = 1
        if self._last_raw is not None and raw in self._numbers:
            distance = (raw - self._last_raw) % len(self._numbers)
            if 0 < distance < len(self._numbers) / 2:
                ahead = distance
        self._last_raw = raw if raw in self._numbers else None
        self._last += ahead
        return self._last
