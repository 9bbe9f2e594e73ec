"""Whether the time on a frame can be true, seen from when it is delivered."""

from __future__ import annotations

from altd.records import Frame

_MAX_AHEAD_NS = 100_000_000
"""Some drivers stamp when the frame is planned to end, and deliver it before (the kernel's vivid, by nearly a
period); and the length of an exposure may not be known exactly."""
MAX_AGE_S = 2.0
"""What lay longer in a buffer, while the computer or the process stood still, shows where the beam was."""


class StampCheck:
    """Refuses frames of one camera that were not yet exposed, that waited too long, or that are not in order.

    A refused frame does not count for the order: one lie costs one frame.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None

    def refusal(self, frame: Frame, now_ns: int) -> str:
        """Why the frame's time cannot be true, in words; empty when it can."""
        ahead_s = (frame.t_ns - now_ns) * 1e-9
        if frame.t_ns > now_ns + _MAX_AHEAD_NS:
            return f"exposure {frame.sequence} is stamped {ahead_s:.3f} s ahead of the clock"
        if -ahead_s > MAX_AGE_S:
            return f"exposure {frame.sequence} is {-ahead_s:.3f} s old"
        if self._last_ns is not None and frame.t_ns <= self._last_ns:
            back_s = (self._last_ns - frame.t_ns) * 1e-9
            return f"exposure {frame.sequence} is stamped {back_s:.3f} s before the one before it"
        self._last_ns = frame.t_ns
        return ""
