"""Blocking calls in threads, whose results are set in the event loop; and threads that give way soon.

A call that never returns blocks only its thread: neither the loop nor the end of the process, which a thread
of ``asyncio.to_thread`` would block. Nothing here keeps the arguments of a call, not even after it
has failed: frames take megabytes, and the garbage collector may not run for hours.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import queue
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import TypeVar

Result = TypeVar("Result")


def call_in_thread(call: Callable[[], Result], name: str) -> asyncio.Future[Result]:
    """The result of a call, or what it raises, from a thread that ends with it."""
    result: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
    threading.Thread(target=_settle, args=(result, call), name=name, daemon=True).start()
    return result


class DeviceThread:
    """Makes the calls of one device, one after the other."""

    def __init__(self, name: str) -> None:
        self._calls: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._idle = asyncio.Event()
        self._idle.set()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    async def call(self, function: Callable[..., Result], *arguments: object, within_s: float) -> Result:
        """The call's result or what it raises; TimeoutError when it, or the one before, takes too long.

        A call that took too long continues; nothing more is called until it has returned.
        """
        result: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
        result.add_done_callback(self._came_back)
        try:
            async with asyncio.timeout(within_s):
                await self._idle.wait()
                self._idle.clear()
                self._calls.put(partial(_settle, result, partial(function, *arguments), self._end_soon))
                return await asyncio.shield(result)
        finally:
            del result, function, arguments  # an error that passes here refers to them, and they to it

    async def end(self, last: Callable[[], None], within_s: float) -> bool:
        """Call ``last`` after what is under way and end; False when the thread does not come back in time."""
        self._calls.put(last)
        self._calls.put(None)
        await asyncio.shield(asyncio.to_thread(self._thread.join, within_s))
        return not self._thread.is_alive()

    def _came_back(self, result: asyncio.Future[Result]) -> None:
        """The thread is free; an exception of the call is ignored if its caller has left."""
        self._idle.set()
        if not result.cancelled():
            result.exception()

    def _run(self) -> None:
        while (call := self._calls.get()) is not None:
            call()
            del call  # and its arguments, before the next one comes

    def _end_soon(self) -> None:
        self._calls.put(None)


def _settle(
    result: asyncio.Future[Result], call: Callable[[], Result], left: Callable[[], None] = lambda: None
) -> None:
    """Make a call in this thread and give its result to the loop; ``left`` is called when that is closed.

    A result that was cancelled meanwhile stays so.
    """
    try:
        give = partial(result.set_result, call())
    except BaseException as error:
        give = partial(result.set_exception, error)
    try:
        result.get_loop().call_soon_threadsafe(_unless_done, result, give)
    except RuntimeError:  # the process is going down
        left()
    finally:
        del result, call, give  # an error refers to the frames that it passed, and to this, which called them


def _unless_done(result: asyncio.Future[Result], give: Callable[[], None]) -> None:
    if not result.done():
        give()


SWITCH_INTERVAL_S = 0.0001
"""Longest time that a computing thread keeps the interpreter from a waiting one; Python's own is 50 times as
long. With 0.5 ms, seven clients that ask for a day of trends at once cost 1 to 4 exposures on a slow PC: its
threads wait for the interpreter a hundred times while they locate and measure one exposure."""


@contextlib.contextmanager
def real_time_interpreter() -> Iterator[None]:
    """Within, threads give way to each other soon, and the garbage collection goes through new objects only.

    What was made before, modules and the calibration above all, lives as long as the process. To go through
    all of that holds every thread for 15 to 30 ms.
    """
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()
    gc.enable()  # a start does without
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before_s)
