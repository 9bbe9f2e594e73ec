"""How late the event loop comes to what is due: a kernel timer wakes it every millisecond."""

from __future__ import annotations

import asyncio
import ctypes
import os
import struct
import time

_CLOCK_MONOTONIC = 1
_TFD_NONBLOCK, _TFD_TIMER_ABSTIME = 0o4000, 1
_TIMES = struct.Struct("qqqq")
"""``struct itimerspec`` of time.h: interval and first expiration, each in s and ns."""
_PERIOD_NS = 1_000_000

_libc = ctypes.CDLL(None, use_errno=True)


class Ticker:
    """``with``: each tick's lateness, ns, in ``late_ns``. asyncio's own timers are a millisecond coarse."""

    def __init__(self) -> None:
        self.late_ns: list[int] = []

    def __enter__(self) -> Ticker:
        """Begin to tick; raises OSError where the kernel has no timer for us."""
        self._timer = _libc.timerfd_create(_CLOCK_MONOTONIC, _TFD_NONBLOCK)
        if self._timer < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._due_ns = time.monotonic_ns() + _PERIOD_NS
        times = ctypes.create_string_buffer(_TIMES.pack(0, _PERIOD_NS, *divmod(self._due_ns, 1_000_000_000)))
        if _libc.timerfd_settime(self._timer, _TFD_TIMER_ABSTIME, times, None) < 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")
        asyncio.get_running_loop().add_reader(self._timer, self._tick)
        return self

    def __exit__(self, *_: object) -> None:
        asyncio.get_running_loop().remove_reader(self._timer)
        os.close(self._timer)

    def _tick(self) -> None:
        (ticks,) = struct.unpack("Q", os.read(self._timer, 8))
        self.late_ns.append(time.monotonic_ns() - self._due_ns)  # of the first that was due
        self._due_ns += ticks * _PERIOD_NS
