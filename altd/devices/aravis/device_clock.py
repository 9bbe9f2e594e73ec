"""A camera's own clock, mapped to the monotonic clock of this computer."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

_BUCKET_NS = 1_000_000_000
_BUCKETS = 5
_JUMP_NS = 50_000_000
"""An offset that changes by more within the window is no drift: 1 % of the window's length."""


@dataclass(slots=True)
class _Bucket:
    """The frames received within one second: the smallest of their offsets."""

    begin_ns: int
    offset_ns: int


class DeviceClock:
    """When a frame's instant on the device's clock was, on the host's.

    Receiving is late by a varying, never by a negative time: the offset between the clocks is the smallest of
    ``receive - device`` over the last five seconds, their lower envelope. A clock that runs 100 ppm off is
    followed within 0.5 ms. A frame that comes late, from a camera that was held up for instance, does not
    move the envelope and keeps its true time.

    A clock that stands still, that goes back again and again, or that runs more than 1 % slow is not
    plausible: then the receive time itself is the answer, until the clock has run well for some seconds.
    """

    def __init__(self) -> None:
        self._buckets: deque[_Bucket] = deque(maxlen=_BUCKETS)
        self._last_device_ns: int | None = None
        self._trusted = True

    @property
    def trusted(self) -> bool:
        """Whether the device's clock is in use, not the receive time."""
        return self._trusted

    def host_ns(self, device_ns: int, receive_ns: int) -> int:
        """The host's time of ``device_ns``, for a frame that was received at ``receive_ns``; never later.

        Frames are to be given in the order in which they were received.
        """
        last_ns, self._last_device_ns = self._last_device_ns, device_ns
        offset_ns = receive_ns - device_ns
        if device_ns <= 0 or (last_ns is not None and device_ns <= last_ns):
            self._distrust()
        elif self._buckets and offset_ns < self._envelope_ns() - _JUMP_NS:
            self._buckets.clear()  # set forward; or all frames until now came late
        self._take(offset_ns, receive_ns)
        over = list(self._buckets)[:-1]  # seconds that are over, so that one late frame does not count
        if len(over) > 1:
            self._trusted = over[-1].offset_ns - over[0].offset_ns <= _JUMP_NS
            if not self._trusted:
                self._distrust()
        return device_ns + self._envelope_ns() if self.trusted else receive_ns

    def _envelope_ns(self) -> int:
        return min(bucket.offset_ns for bucket in self._buckets)

    def _take(self, offset_ns: int, receive_ns: int) -> None:
        if not self._buckets or receive_ns - self._buckets[-1].begin_ns >= _BUCKET_NS:
            self._buckets.append(_Bucket(receive_ns, offset_ns))
        else:
            self._buckets[-1].offset_ns = min(self._buckets[-1].offset_ns, offset_ns)

    def _distrust(self) -> None:
        self._trusted = False
        self._buckets.clear()
