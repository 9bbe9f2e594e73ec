"""Blocking calls of one device in a thread of their own."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from typing import TypeVar

Result = TypeVar("Result")


class OwnThread:
    """Makes one call after the other.

    A call that never comes back holds this thread and nobody else: neither the loop nor the end of the
    process, which a thread of ``asyncio.to_thread`` would hold.
    """

    def __init__(self, name: str) -> None:
        self._loop = asyncio.get_running_loop()
        self._calls: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._idle = asyncio.Event()
        self._idle.set()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    async def call(self, function: Callable[..., Result], *arguments: object, within_s: float) -> Result:
        """The call's result or what it raises; TimeoutError when it, or the one before, takes too long.

        A call that took too long goes on; nothing more is called until it has come back.
        """
        future: asyncio.Future[Result] = self._loop.create_future()

        def settle(error: BaseException | None, result: Result | None) -> None:
            self._idle.set()
            if future.done():
                return  # nobody waits any more
            if error is not None:
                future.set_exception(error)
            else:
                future.set_result(result)  # type: ignore[arg-type]  # None only where Result is

        def work() -> None:
            try:
                result = function(*arguments)
            except BaseException as error:
                self._tell(settle, error, None)
            else:
                self._tell(settle, None, result)

        async with asyncio.timeout(within_s):
            await self._idle.wait()
            self._idle.clear()
            self._calls.put(work)
            return await future

    async def end(self, last: Callable[[], None], within_s: float) -> bool:
        """Call ``last`` after what is under way and end; False when the thread does not come back in time."""
        self._calls.put(last)
        self._calls.put(None)
        await asyncio.shield(asyncio.to_thread(self._thread.join, within_s))
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (work := self._calls.get()) is not None:
            work()

    def _tell(self, function: Callable[..., None], *arguments: object) -> None:
        try:
            self._loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:
            self._calls.put(None)  # the loop is closed: the process is going down
