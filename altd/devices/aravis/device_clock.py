"""Mapping of a camera's own clock to the monotonic clock of this computer."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

_BUCKET_NS = 1_000_000_000
_BUCKETS = 5
_TOLERANCE_NS = 8_000_000
"""Accepted advance or delay of a frame relative to those before it. The delay by network, driver and threads
varies by less, and so does a drift of 0.1 % in five seconds."""
_VERY_LATE_NS = 25_000_000
_VERY_LATE_FRAMES, _VERY_LATE_BAND_NS = 4, 4_000_000
_LATE_FRAMES, _LATE_BAND_NS = 20, 8_000_000
"""This many late frames in a row indicate a clock fault, if three quarters of them are within the band about
a straight line that does not fall; the fewer ones must be late by more than ``_VERY_LATE_NS``. A clock that
was set or runs slow causes that. Delays by a busy computer or network scatter and decrease."""
_MIN_SHARE_ON_LINE = 0.75
_MAX_FALL_NS = 1_000_000
_MAX_LATE_KEPT = 100
_STEP_TIMEOUT_NS = 2_200_000_000
"""A delay that grows on a line for this long, without one frame in time, is due to the clock. Half a window
of exposures and the pairing with the other camera follow until a value is valid: 2.9 s in all."""
_ENVELOPE_TIMEOUT_NS = 10_000_000_000
"""Time without a frame on the envelope after which it is rebuilt from the late frames."""
_MAX_BACK_IN_A_ROW = 3
_SETTLING_FRAMES = 10
"""Number of first frames that may be late themselves."""
_FIRST_FRAMES, _FIRST_FALL_NS, _FIRST_TIMEOUT_NS = 5, 2_000_000, 1_000_000_000
"""The envelope of a newly opened camera is known after ``_FIRST_FRAMES`` that have not lowered it by more
than ``_FIRST_FALL_NS``, or after the timeout: a computer that is busy starting receives the first frames tens
of ms late."""
_MIN_STEADY_FRAMES = 20
"""Number of frames that must agree with a clock that was implausible before it is used again."""


@dataclass(slots=True)
class _Bucket:
    """Frames received within one second: the smallest of their offsets."""

    begin_ns: int
    offset_ns: int


class DeviceClock:
    """Maps instants of frames from the device's clock to the host's.

    Reception is late by a varying, never by a negative time: the offset between the clocks is the smallest of
    ``receive - device`` over the last five seconds, their lower envelope. A clock that runs 100 ppm off is
    followed within 0.5 ms. A late frame, for instance from a camera that was delayed, does not move the
    envelope and keeps its true time.

    Consecutive frames that are late by the same or a growing time were delayed, or the clock was set back or
    runs slow. The cause is unknown, so they have no time until a frame is in time again or the condition has
    lasted for some seconds. A frame that is too early has a wrong stamp: it gets the time of its arrival, and
    so do the following frames if they agree.

    Before ``known`` the envelope is still falling, and the times of the first frames are too late by that.

    A clock that stops or runs back for more than three frames is not plausible: the receive time is then used
    until the clock has run well for a second.
    """

    def __init__(self) -> None:
        self.known = False
        """Whether enough frames have arrived to determine the offset of the clock."""
        self._first: tuple[int, int, int] | None = None
        """Until then: receive time of the first frame, smallest offset, and number of frames since that."""
        self._buckets: deque[_Bucket] = deque(maxlen=_BUCKETS)
        self._last_device_ns: int | None = None
        self._steady = _MIN_STEADY_FRAMES
        """Number of frames in a row that agreed since the clock was not plausible."""
        self._in_a_row_back = 0
        self._early_offset_ns: int | None = None
        self._mapped = 0
        """Number of frames since the mapping was restarted."""
        self._late_ns: deque[tuple[int, int]] = deque(maxlen=_MAX_LATE_KEPT)
        """Receive times and offsets of the late frames in a row."""
        self._late_since_ns = 0

    @property
    def trusted(self) -> bool:
        """Whether the device's clock is used, not the receive time."""
        return self._steady >= _MIN_STEADY_FRAMES

    def host_ns(self, device_ns: int, receive_ns: int) -> int | None:
        """Host time of ``device_ns``, for a frame received at ``receive_ns``; never later than that.

        None where it is unknown. Frames must be passed in the order in which they were received.
        """
        offset_ns = receive_ns - device_ns
        if not self.known:
            self._take_first(offset_ns, receive_ns)
        if device_ns <= 0 or (self._last_device_ns is not None and device_ns <= self._last_device_ns):
            return self._back(device_ns, receive_ns)
        self._in_a_row_back = 0
        if not self._buckets:
            self._add(offset_ns, receive_ns)
        beyond_ns = offset_ns - self._envelope_ns()
        self._mapped += 1
        if beyond_ns < -_TOLERANCE_NS and self._mapped > _SETTLING_FRAMES:
            return self._early(device_ns, offset_ns, receive_ns)
        self._last_device_ns = device_ns
        self._early_offset_ns = None
        if beyond_ns > _TOLERANCE_NS:
            return self._late(offset_ns, device_ns, receive_ns)
        self._late_ns.clear()
        self._steady += not self.trusted
        self._add(offset_ns, receive_ns)
        return device_ns + self._envelope_ns() if self.trusted else receive_ns

    def _take_first(self, offset_ns: int, receive_ns: int) -> None:
        began_ns, smallest_ns, frames = self._first or (receive_ns, offset_ns, 0)
        if offset_ns < smallest_ns - _FIRST_FALL_NS:
            smallest_ns, frames = offset_ns, 0
        self._first = began_ns, smallest_ns, frames + 1
        self.known = frames + 1 > _FIRST_FRAMES or receive_ns - began_ns >= _FIRST_TIMEOUT_NS

    def _back(self, device_ns: int, receive_ns: int) -> int | None:
        """Handle a stamp not later than the last: the frame was overtaken, or the clock has stopped."""
        self._in_a_row_back += 1
        if self.trusted and self._in_a_row_back <= _MAX_BACK_IN_A_ROW:
            return None
        self._last_device_ns = device_ns
        self._restart(steady=0)
        return receive_ns

    def _early(self, device_ns: int, offset_ns: int, receive_ns: int) -> int:
        """Handle a stamp that is later than possible: it is wrong, or the clock was set forward."""
        known_ns, self._early_offset_ns = self._early_offset_ns, offset_ns
        if known_ns is not None:
            self._last_device_ns = device_ns
            agrees = abs(offset_ns - known_ns) <= _TOLERANCE_NS
            self._restart(steady=self._steady if agrees else 0)
            self._add(offset_ns, receive_ns)
        return receive_ns

    def _late(self, offset_ns: int, device_ns: int, receive_ns: int) -> int | None:
        """Handle a late frame: it was delayed, or the clock was set back or runs slow."""
        if not self.trusted:
            self._restart(steady=0)
            self._add(offset_ns, receive_ns)
            return receive_ns
        if not self._late_ns:
            self._late_since_ns = receive_ns
        self._late_ns.append((receive_ns, offset_ns))
        lasted_ns = receive_ns - self._late_since_ns
        if lasted_ns > _ENVELOPE_TIMEOUT_NS:
            smallest_ns = min(offset for _, offset in self._late_ns)
            self._restart(steady=self._steady)
            self._add(smallest_ns, receive_ns)
        elif self._are_on_a_line(_LATE_FRAMES, _TOLERANCE_NS, _LATE_BAND_NS):
            if lasted_ns <= _STEP_TIMEOUT_NS:
                return None
            is_steady = offset_ns - self._late_ns[0][1] <= _TOLERANCE_NS
            self._restart(steady=_MIN_STEADY_FRAMES if is_steady else 0)
            self._add(offset_ns, receive_ns)
            return receive_ns
        elif self._are_on_a_line(_VERY_LATE_FRAMES, _VERY_LATE_NS, _VERY_LATE_BAND_NS):
            return None
        return min(device_ns + self._envelope_ns(), receive_ns)

    def _are_on_a_line(self, count: int, min_late_ns: int, band_ns: int) -> bool:
        """Whether the last ``count`` frames are all late enough, and three quarters of them on one line."""
        if len(self._late_ns) < count:
            return False
        envelope_ns = self._envelope_ns()
        offsets_ns = np.array([float(offset_ns - envelope_ns) for _, offset_ns in self._late_ns])[-count:]
        if offsets_ns.min() < min_late_ns:
            return False
        first, second = np.triu_indices(count, 1)
        slope_ns = float(np.median((offsets_ns[second] - offsets_ns[first]) / (second - first)))
        level_ns = offsets_ns - slope_ns * np.arange(count)
        near = np.abs(level_ns - np.median(level_ns)) <= band_ns / 2
        return slope_ns > -_MAX_FALL_NS and float(near.mean()) >= _MIN_SHARE_ON_LINE

    def _envelope_ns(self) -> int:
        return min(bucket.offset_ns for bucket in self._buckets)

    def _add(self, offset_ns: int, receive_ns: int) -> None:
        if not self._buckets or receive_ns - self._buckets[-1].begin_ns >= _BUCKET_NS:
            self._buckets.append(_Bucket(receive_ns, offset_ns))
        else:
            self._buckets[-1].offset_ns = min(self._buckets[-1].offset_ns, offset_ns)

    def _restart(self, steady: int) -> None:
        self._buckets.clear()
        self._steady = steady
        self._early_offset_ns = None
        self._late_ns.clear()
        self._mapped = 0
