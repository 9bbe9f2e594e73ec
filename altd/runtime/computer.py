"""Whether the computer gives the daemon a processor in time.

Where it does not, frames seem to be lost or not synchronised, and no cable is at fault. The hardened service
sees no process but its own (``ProcSubset=pid``), so both figures are of this process: how long its threads
waited for a processor while they could have run, and how late its event loop was, which also shows a
processor that the host of a virtual machine took away.
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

MAX_WAITING = 0.2
"""Maximum share of the time for which a thread may wait for a processor.

A simulated unit lost nothing at 0.14, and half of its windows at 0.85."""

MAX_LATE_S = 0.1
"""Maximum lateness of the event loop, s."""

HELD_S = 10.0
"""Time for which the computer counts as busy after it last was, s: its effects are seen later."""

_HEARTBEAT_S = 10.0


def waited_ns() -> Mapping[str, int]:
    """Return how long each thread of this process has waited for a processor, ns (proc(5), schedstat)."""
    waited = {}
    for thread in os.scandir("/proc/self/task"):
        with contextlib.suppress(
            OSError, ValueError, IndexError
        ):  # it has ended, or the kernel does not count
            waited[thread.name] = int(Path(thread.path, "schedstat").read_text().split()[1])
    return waited


async def watch_computer(
    component: Component, clock: Clock, waited: Callable[[], Mapping[str, int]] = waited_ns
) -> None:
    """Report in a component until cancelled whether the computer is busy."""
    component.expect(_HEARTBEAT_S)
    before, before_ns = waited(), clock.monotonic_ns()
    busy_ns: int | None = None
    while True:
        await clock.sleep(LOOK_S)
        now, now_ns = waited(), clock.monotonic_ns()
        passed_s = (now_ns - before_ns) * 1e-9
        waiting_s = max((ns - before.get(thread, ns) for thread, ns in now.items()), default=0) * 1e-9
        share, late_s = waiting_s / passed_s, passed_s - LOOK_S
        before, before_ns = now, now_ns
        component.observe({"waiting_share": round(share, 3), "late_ms": round(1e3 * late_s, 1)})
        if share > MAX_WAITING or late_s > MAX_LATE_S:
            busy_ns = now_ns
            text = f"altd waited {share:.0%} of the time for a processor and was {late_s:.2f} s late"
            component.set_state(State.DEGRADED, text)
        elif busy_ns is None or now_ns - busy_ns > HELD_S * 1e9:
            component.set_state(State.OK)
        component.is_alive()
