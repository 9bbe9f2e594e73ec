"""The interpreter set up so that nothing in it holds the event loop for long."""

from __future__ import annotations

import contextlib
import gc
import sys
from collections.abc import Iterator

SWITCH_INTERVAL_S = 0.0005
"""Longest time that a computing thread keeps the interpreter from a waiting one; Python's own is ten times
as long."""


@contextlib.contextmanager
def real_time_interpreter() -> Iterator[None]:
    """Within, threads give way to each other soon, and the garbage collection looks at new objects only.

    What was made before, modules and the calibration above all, lives as long as the process. To go through
    all of that holds every thread for 15 to 30 ms.
    """
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before_s)
