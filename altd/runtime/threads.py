"""Blocking calls in threads, with results set in the event loop; and a short switch interval of threads.

A call that never returns blocks only its thread, not the loop and not the end of the process, which a thread
of ``asyncio.to_thread`` would block. The arguments of a call are not kept, not even after a failure:
frames take megabytes, and the garbage collector may not run for hours.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import queue
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, TypeVar

log = logging.getLogger("altd")

Result = TypeVar("Result")

NO_LIMIT_S = 1e9


def call_in_thread(call: Callable[[], Result], name: str) -> asyncio.Future[Result]:
    """Make a call in a new thread, which ends with it; return the future of its result or exception."""
    result: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
    threading.Thread(target=_settle, args=(result, call), name=name, daemon=True).start()
    return result


class SingleCall:
    """Makes one call at a time, each in a new thread: while one hangs, no second one begins."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._running: asyncio.Future[Any] | None = None

    async def call(self, function: Callable[[], Result], within_s: float | None = None) -> Result:
        """Return or raise the outcome of a call; TimeoutError if it or the one before takes too long.

        A call that timed out or was cancelled continues.
        """
        async with asyncio.timeout(within_s):
            while self._running is not None:
                await asyncio.wait({self._running})
            self._running = call_in_thread(function, self._name)
            self._running.add_done_callback(self._returned)
            return await asyncio.shield(self._running)

    def _returned(self, result: asyncio.Future[Any]) -> None:
        """Allow the next call; mark the exception as retrieved: the caller may have left."""
        self._running = None
        if not result.cancelled():
            result.exception()


class DeviceThread:
    """Makes the calls of one device, one after the other."""

    def __init__(self, name: str) -> None:
        self._calls: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._turn = asyncio.Lock()
        """Held from a call's start until its outcome is known."""
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    async def call(
        self,
        function: Callable[..., Result],
        *arguments: object,
        within_s: float,
        undo: Callable[[Result], object] | None = None,
    ) -> Result:
        """Return or raise the outcome of a call; TimeoutError if it or the one before takes too long.

        A call that times out or is cancelled before it began is never made. One that has begun continues;
        ``undo`` is then called with its result, in the thread. The next call starts only after it returned.
        """
        result: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
        begun = threading.Lock()  # taken by the thread, or by a caller who leaves before
        try:
            async with asyncio.timeout(within_s):
                await self._turn.acquire()
                result.add_done_callback(self._came_back)
                self._calls.put(
                    partial(_settle, result, partial(function, *arguments), self._end_soon, begun)
                )
                try:
                    return await asyncio.shield(result)
                except asyncio.CancelledError:
                    if begun.acquire(blocking=False):
                        result.cancel()
                    elif undo is not None:
                        result.add_done_callback(partial(self._undo, undo))
                    raise
        finally:
            del result, function, arguments, undo  # else an exception refers to them, and they to it

    async def end(self, last: Callable[[], None], within_s: float) -> bool:
        """Call ``last`` after the pending calls and end the thread; return whether it ended in time."""
        self._calls.put(partial(_without_caller, last))
        self._calls.put(None)
        await asyncio.shield(call_in_thread(partial(self._thread.join, within_s), self._thread.name))
        return not self._thread.is_alive()

    def _came_back(self, result: asyncio.Future[Result]) -> None:
        """Let the next call start; mark the call's exception as retrieved: its caller may have left."""
        self._turn.release()
        if not result.cancelled():
            result.exception()

    def _undo(self, undo: Callable[[Result], object], result: asyncio.Future[Result]) -> None:
        """Undo a call whose caller has left, before the next one."""
        if not result.cancelled() and result.exception() is None:
            self._calls.put(partial(_without_caller, partial(undo, result.result())))

    def _run(self) -> None:
        while (call := self._calls.get()) is not None:
            call()
            del call  # and its arguments, before waiting for the next call

    def _end_soon(self) -> None:
        self._calls.put(None)


def _settle(
    result: asyncio.Future[Result],
    call: Callable[[], Result],
    left: Callable[[], None] = lambda: None,
    begun: threading.Lock | None = None,
) -> None:
    """Make a call in this thread and pass its result to the loop; call ``left`` if the loop is closed.

    A future that was cancelled meanwhile stays cancelled. No call is made if ``begun`` is taken.
    """
    if begun is not None and not begun.acquire(blocking=False):
        return
    try:
        give = partial(result.set_result, call())
    except BaseException as error:
        give = partial(result.set_exception, error)
    try:
        result.get_loop().call_soon_threadsafe(_unless_done, result, give)
    except RuntimeError:  # the process is ending
        left()
    finally:
        del result, call, give  # breaks the cycle with an exception, which refers to this frame


def _without_caller(call: Callable[[], object]) -> None:
    """Make a call that ends or undoes; log what it raises."""
    try:
        call()
    except Exception:
        log.exception("%s: a defect", threading.current_thread().name)


def _unless_done(result: asyncio.Future[Result], give: Callable[[], None]) -> None:
    if not result.done():
        give()


SWITCH_INTERVAL_S = 0.0001
"""Maximum time for which a computing thread keeps the interpreter from a waiting thread; Python's default is
50 times as long. With 0.5 ms, seven simultaneous requests of a day of trends cost 1 to 4 exposures on a slow
PC: its threads wait for the interpreter a hundred times per located and measured exposure."""


@contextlib.contextmanager
def real_time_interpreter() -> Iterator[None]:
    """Context with fast switching of threads and garbage collection of new objects only.

    Earlier objects, mainly modules and the calibration, live as long as the process. Collecting over all of
    them would block every thread for 15 to 30 ms.
    """
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()
    gc.enable()  # it is disabled during the start
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before_s)
