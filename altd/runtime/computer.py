"""Whether the computer gives the daemon a processor in time.

Where it does not, frames seem to be lost or not synchronised, and no cable is at fault. The hardened service
sees no process but its own (``ProcSubset=pid``), so both figures are of this process: how long its threads
waited for a processor while they could have run, and how late its event loop was, which also shows a
processor that the host of a virtual machine took away.

The limit is a thread that waits longer than it rests. A simulated unit whose busiest thread ran a quarter of
the time lost nothing while that waited for 0.40 of it, and lost frames from 0.52.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path

from altd.ports import Clock
from altd.status.health import Component, State

LOOK_S = 0.5
"""Interval of observations, s."""

MAX_LATE_S = 0.1
"""Maximum lateness of the event loop, s."""

HELD_S = 10.0
"""Time for which the computer counts as busy after it last was, s: its effects are seen later."""

_HEARTBEAT_S = 10.0

Times = tuple[int, int]
"""Times for which a thread has run, and has waited for a processor, ns."""


def times_of_threads() -> Mapping[str, Times]:
    """Return the times of each thread of this process (proc(5), schedstat)."""
    times = {}
    for thread in os.scandir("/proc/self/task"):
        with contextlib.suppress(OSError, ValueError):  # it has ended, or the kernel does not count
            ran, waited, _ = map(int, Path(thread.path, "schedstat").read_text().split())
            times[thread.name] = ran, waited
    return times


async def watch_computer(
    component: Component, clock: Clock, times: Callable[[], Mapping[str, Times]] = times_of_threads
) -> None:
    """Report in a component until cancelled whether the computer is busy."""
    component.expect(_HEARTBEAT_S)
    before, before_ns = times(), clock.monotonic_ns()
    busy_ns: int | None = None
    while True:
        await clock.sleep(LOOK_S)
        now, now_ns = times(), clock.monotonic_ns()
        passed_ns = now_ns - before_ns
        late_s = passed_ns * 1e-9 - LOOK_S
        passed = [
            (waited - before[thread][1], ran - before[thread][0])
            for thread, (ran, waited) in now.items()
            if thread in before
        ]
        share = max((waited for waited, _ in passed), default=0) / passed_ns
        before, before_ns = now, now_ns
        component.observe({"waiting_share": round(share, 3), "late_ms": round(1e3 * late_s, 1)})
        if late_s > MAX_LATE_S or any(waited > passed_ns - ran - waited for waited, ran in passed):
            busy_ns = now_ns
            text = f"altd waited {share:.0%} of the time for a processor and was {late_s:.2f} s late"
            component.set_state(State.DEGRADED, text)
        elif busy_ns is None or now_ns - busy_ns > HELD_S * 1e9:
            component.set_state(State.OK)
        component.is_alive()
