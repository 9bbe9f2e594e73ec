"""A busy computer is reported within a second, and no longer than its effects last."""

import asyncio
import threading
import time

import pytest
from support.clock import FakeClock

from altd.runtime.computer import HELD_S, LOOK_S, MAX_LATE_S, Times, times_of_threads, watch_computer
from altd.status.health import Component, State


class Computer:
    """One whose busiest thread runs ``ran`` of the time and waits ``waited``; its loop is ``late_s`` late."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        self.component = Component("computer", self.clock)
        self.ran, self.waited, self.late_s = 0.25, 0.0, 0.0
        self._times_s = [0.0, 0.0]

    def times(self) -> dict[str, Times]:
        self.clock.now_ns += round(self.late_s * 1e9)
        self._times_s = [self._times_s[0] + self.ran * LOOK_S, self._times_s[1] + self.waited * LOOK_S]
        ran_ns, waited_ns = (round(1e9 * seconds) for seconds in self._times_s)
        idle = begun = 10**12, 10**12
        return {"1": (ran_ns, waited_ns), "2": idle, f"begun {self.clock.now_ns}": begun}

    async def after(self, seconds: float) -> State:
        await self.clock.advance(seconds)
        return self.component.state


async def watched(computer: Computer) -> asyncio.Task[None]:
    watching = asyncio.create_task(watch_computer(computer.component, computer.clock, computer.times))
    assert await computer.after(2 * LOOK_S) is State.OK
    return watching


async def test_threads_that_wait_for_a_processor_make_it_busy_until_their_effects_are_gone() -> None:
    computer = Computer()
    watching = await watched(computer)
    computer.waited = 0.37
    assert await computer.after(2.0) is State.OK
    computer.waited = 0.38
    assert await computer.after(2 * LOOK_S) is State.DEGRADED
    assert computer.component.message.startswith("altd waited 38% of the time for a processor")
    assert computer.component.figures["waiting_share"] == 0.38
    computer.waited = 0.0
    assert await computer.after(HELD_S - 2 * LOOK_S) is State.DEGRADED
    assert await computer.after(4 * LOOK_S) is State.OK
    watching.cancel()


async def test_an_event_loop_that_is_late_makes_it_busy_where_the_kernel_counts_no_waiting() -> None:
    computer = Computer()
    watching = await watched(computer)
    computer.late_s = MAX_LATE_S / 2
    assert await computer.after(2.0) is State.OK
    computer.late_s = 2 * MAX_LATE_S
    assert await computer.after(2 * LOOK_S) is State.DEGRADED
    watching.cancel()


def test_the_kernel_counts_for_each_thread_of_this_process() -> None:
    before, thread = time.thread_time_ns(), str(threading.get_native_id())
    ran_ns, waited_ns = times_of_threads()[thread]
    assert ran_ns == pytest.approx(before, abs=1e8)
    assert waited_ns >= 0
    assert len(times_of_threads()) >= threading.active_count()
