"""A busy computer is reported within a second, and no longer than its effects last."""

import asyncio
import threading

from support.clock import FakeClock

from altd.runtime.computer import HELD_S, LOOK_S, MAX_LATE_S, MAX_WAITING, waited_ns, watch_computer
from altd.status.health import Component, State


class Computer:
    """One with two threads: one waits for ``share`` of the time. ``late_s``: lateness of the event loop."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        self.component = Component("computer", self.clock)
        self.share, self.late_s = 0.0, 0.0
        self._waited_ns = 0

    def waited(self) -> dict[str, int]:
        self._waited_ns += round(self.share * LOOK_S * 1e9)
        self.clock.now_ns += round(self.late_s * 1e9)
        return {"1": self._waited_ns, "2": 10**12, str(self.clock.now_ns): 10**12}

    async def after(self, seconds: float) -> State:
        await self.clock.advance(seconds)
        return self.component.state


async def watched(computer: Computer) -> asyncio.Task[None]:
    watching = asyncio.create_task(watch_computer(computer.component, computer.clock, computer.waited))
    assert await computer.after(2 * LOOK_S) is State.OK
    return watching


async def test_threads_that_wait_for_a_processor_make_it_busy_until_their_effects_are_gone() -> None:
    computer = Computer()
    watching = await watched(computer)
    computer.share = MAX_WAITING * 0.9
    assert await computer.after(2.0) is State.OK
    computer.share = 0.9
    assert await computer.after(2 * LOOK_S) is State.DEGRADED
    assert computer.component.message.startswith("altd waited 90% of the time for a processor")
    assert computer.component.figures["waiting_share"] == 0.9
    computer.share = 0.0
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
    waited = waited_ns()
    assert waited[str(threading.get_native_id())] >= 0
    assert len(waited) >= threading.active_count()
