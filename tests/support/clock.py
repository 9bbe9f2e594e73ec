"""A clock that a test drives: an hour passes in as many steps as there are sleepers."""

import asyncio
import heapq
import math
import threading
import time
from collections.abc import Callable, Coroutine
from datetime import UTC, datetime, timedelta
from functools import partial
from itertools import count
from queue import SimpleQueue
from typing import Any, Self, TypeVar
from weakref import WeakSet

import pytest

from altd.acquisition.locating import Locating
from altd.ports import Stop
from altd.runtime.threads import DeviceThread

Result = TypeVar("Result")
START = datetime(2026, 11, 20, 8, 0, tzinfo=UTC)
_STEPS = 10
"""Turns of the loop within which a task that is woken waits again, or has begun a call."""


class FakeClock:
    """Time stands still until ``advance`` lets it pass."""

    def __init__(self, now_ns: int = 0) -> None:
        self.now_ns = now_ns
        self._due: list[tuple[int, int, Callable[[], object]]] = []
        self._number = count()
        self._arrived: SimpleQueue[tuple[int, threading.Event]] = SimpleQueue()
        self._idle: set[threading.Event] = set()
        self._calls: set[asyncio.Future[Any]] = set()
        self._devices: list[DeviceThread] = []
        self.waits_for_locating = False
        """Whether time stands still while spots are located, by a thread that is prepared from now on."""
        self._locating: list[_Arrived] = []
        self._ended = threading.Event()

    @classmethod
    def of_loop(cls, now_ns: int = 10**9) -> Self:
        """One that the timers of the running loop obey too, such as those of ``asyncio.timeout``.

        Time passes only while nothing is under way in ``asyncio.to_thread``, nor in a device's thread.
        """
        clock, loop = cls(now_ns), asyncio.get_running_loop()
        clock.watch_devices()
        began_s, call_at, run_in_executor = loop.time(), loop.call_at, loop.run_in_executor

        def call_at_and_note(when: float, *arguments: Any, **named: Any) -> asyncio.TimerHandle:
            clock._call(now_ns + math.ceil((when - began_s) * 1e9), lambda: None)
            return call_at(when, *arguments, **named)

        def run_in_executor_and_note(*arguments: Any) -> asyncio.Future[Any]:
            clock._calls.add(call := run_in_executor(*arguments))
            call.add_done_callback(clock._calls.discard)
            return call

        loop.time = lambda: began_s + (clock.now_ns - now_ns) * 1e-9  # type: ignore[method-assign]
        loop.call_at = call_at_and_note  # type: ignore[method-assign]
        loop.run_in_executor = run_in_executor_and_note  # type: ignore[method-assign]
        return clock

    def monotonic_ns(self) -> int:
        return self.now_ns

    def utc(self, t_ns: int) -> datetime:
        return START + timedelta(microseconds=t_ns / 1000)

    async def sleep(self, seconds: float) -> None:
        future = asyncio.get_running_loop().create_future()
        self._call(self.now_ns + round(seconds * 1e9), lambda: future.done() or future.set_result(None))
        await future

    def wait(self, stop: Stop, seconds: float) -> None:
        woken = threading.Event()
        self._arrived.put((self.now_ns + round(seconds * 1e9), woken))
        self._idle.add(woken)
        while not (woken.wait(0.005) or stop.is_set() or self._ended.is_set()):
            pass
        self._idle.discard(woken)

    def hold(self, until: threading.Event) -> None:
        """Hold a thread until ``release``; time passes meanwhile."""
        self.rest(until)
        while not (until.wait(0.005) or self._ended.is_set()):
            pass

    def rest(self, until: threading.Event) -> None:
        """A thread is about to wait for something else, until ``release``."""
        self._idle.add(until)

    def release(self, held: threading.Event) -> None:
        self._idle.discard(held)
        held.set()

    async def advance(self, seconds: float) -> None:
        """Let time pass, waking sleepers in order; each has its say before the next one wakes."""
        end_ns = self.now_ns + round(seconds * 1e9)
        await self.settle()
        while self._due and self._due[0][0] <= end_ns:
            due_ns, _, wake = heapq.heappop(self._due)
            self.now_ns = max(self.now_ns, due_ns)
            wake()
            await self.settle()
        self.now_ns = end_ns
        await settle()

    async def jump(self, seconds: float) -> None:
        """Let time pass at one blow, as when the process was held: all that is due wakes at the end."""
        await self.settle()
        self.now_ns += round(seconds * 1e9)
        while self._due and self._due[0][0] <= self.now_ns:
            heapq.heappop(self._due)[2]()
        await settle()

    async def until(self, condition: Callable[[], object], within_s: float = 60.0) -> None:
        """Let time pass in small steps until something is so."""
        end_ns = self.now_ns + round(within_s * 1e9)
        await self.settle()
        while not condition():
            assert self.now_ns < end_ns, f"not within {within_s:g} s"
            await self.advance(0.01)

    async def run(self, awaited: Coroutine[Any, Any, Result]) -> Result:
        """Let time pass until something has come to its end."""
        task = asyncio.create_task(awaited)
        await self.until(task.done)
        return await task

    async def settle(self) -> None:
        """Let every task run until it waits, and every thread until it waits for this clock."""
        still = 0
        while still < _STEPS:  # after a thread's last outcome: its caller may make the next call
            await asyncio.sleep(0)
            still += 1
            if self._calls or not self._has_threads_waiting:
                time.sleep(0.0002)  # noqa: ASYNC251  it gives way to the threads
                still = 0
        while not self._arrived.empty():
            due_ns, woken = self._arrived.get()
            self._call(due_ns, partial(self._wake, woken))

    def watch_devices(self) -> None:
        """Time passes only while each call of a device that is begun from now on waits for this clock."""
        _WATCHING.add(self)

    @property
    def _has_threads_waiting(self) -> bool:
        busy = sum(device._turn.locked() for device in self._devices)  # noqa: SLF001
        return len(self._idle) >= busy and all(thread.is_idle for thread in self._locating)

    async def stop(self, task: asyncio.Task[None]) -> None:
        """Cancel a task, and let pass what time it takes to be gone."""
        task.cancel()
        while not task.done():
            await self.advance(0.01)
            time.sleep(0.0002)  # noqa: ASYNC251  as above
        assert task.cancelled()

    def end(self) -> None:
        """Let all threads go, and the loop's timers run by its own clock."""
        self._ended.set()
        for name in ("time", "call_at", "run_in_executor"):
            vars(asyncio.get_running_loop()).pop(name, None)

    def _call(self, due_ns: int, wake: Callable[[], object]) -> None:
        heapq.heappush(self._due, (due_ns, next(self._number), wake))

    def _wake(self, woken: threading.Event) -> None:
        self._idle.discard(woken)
        woken.set()


_WATCHING: WeakSet[FakeClock] = WeakSet()
_begin = DeviceThread.__init__


def _begin_and_note(device: DeviceThread, name: str) -> None:
    _begin(device, name)
    for clock in _WATCHING:
        clock._devices.append(device)  # noqa: SLF001


class _Arrived(threading.Event):
    """The event that wakes the locating thread, which is idle while it waits for it."""

    _is_waited_for, has_ended = True, False

    @property
    def is_idle(self) -> bool:
        return self.has_ended or (self._is_waited_for and not self.is_set())

    def wait(self, timeout: float | None = None) -> bool:
        self._is_waited_for = True
        try:
            return super().wait(timeout)
        finally:
            self._is_waited_for = False


_prepare, _locate_all = Locating.__init__, Locating._locate_all  # noqa: SLF001


def _prepare_and_note(locating: Locating[Any], *arguments: Any, **named: Any) -> None:
    _prepare(locating, *arguments, **named)
    locating._arrived = arrived = _Arrived()  # noqa: SLF001
    for clock in _WATCHING:
        if clock.waits_for_locating:
            clock._locating.append(arrived)  # noqa: SLF001


def _locate_all_and_note(locating: Locating[Any], *arguments: Any) -> None:
    try:
        _locate_all(locating, *arguments)
    finally:
        if isinstance(arrived := locating._arrived, _Arrived):  # noqa: SLF001
            arrived.has_ended = True


pytest.MonkeyPatch().setattr(Locating, "_locate_all", _locate_all_and_note)
pytest.MonkeyPatch().setattr(DeviceThread, "__init__", _begin_and_note)
pytest.MonkeyPatch().setattr(Locating, "__init__", _prepare_and_note)


async def stop(task: asyncio.Task[None]) -> None:
    """Cancel a task and wait until it is gone."""
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    if not task.cancelled():
        raise AssertionError("it ended before it was stopped") from task.exception()


async def settle() -> None:
    """Let every task run until it waits."""
    for _ in range(_STEPS):
        await asyncio.sleep(0)
