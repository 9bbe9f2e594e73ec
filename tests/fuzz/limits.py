"""Limits of one example: time and memory. More is a defect, as an exception is."""

import resource
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

CPU_S = 2.0
"""Of this process; a busy computer does not add to it."""
WAITING_S = 30.0
"""By the clock, for a check that waits for something that never comes."""
GROWTH_BYTES = 512 << 20
"""By how much the process may become larger than it has ever been."""


class TooMuchError(Exception):
    """An example took more time or memory than any input may cost."""


@contextmanager
def bounded() -> Iterator[None]:
    """Raise TooMuchError when the body exceeds a limit; a call into C is interrupted when it returns."""
    if threading.current_thread() is not threading.main_thread():
        raise RuntimeError("signals reach the main thread only")
    before = {
        number: signal.signal(number, handler)
        for number, handler in ((signal.SIGPROF, _cpu_is_up), (signal.SIGALRM, _time_is_up))
    }
    largest = _largest_bytes()
    signal.setitimer(signal.ITIMER_PROF, CPU_S)
    signal.setitimer(signal.ITIMER_REAL, WAITING_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
    grown = _largest_bytes() - largest
    if grown > GROWTH_BYTES:
        raise TooMuchError(f"the process grew by {grown >> 20} MiB")


def _largest_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _cpu_is_up(_number: int, _frame: FrameType | None) -> None:
    raise TooMuchError(f"more than {CPU_S:g} s of computing")


def _time_is_up(_number: int, _frame: FrameType | None) -> None:
    raise TooMuchError(f"more than {WAITING_S:g} s by the clock")
