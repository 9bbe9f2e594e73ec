"""An interface that serves as long as a test runs."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable

from altd.runtime.supervision import Publisher

GONE = "the port is gone"


def lines(count: int) -> Callable[[bytes], bool]:
    return lambda data: data.count(b"\n") >= count


@contextlib.asynccontextmanager
async def serving(face: Publisher) -> AsyncIterator[asyncio.Task[None]]:
    """Its task, once it serves; raises what ended it before."""
    ready = asyncio.Event()
    task = asyncio.ensure_future(face.run(ready.set))
    waiting = asyncio.ensure_future(ready.wait())
    await asyncio.wait({task, waiting}, return_when=asyncio.FIRST_COMPLETED)
    waiting.cancel()
    try:
        if task.done():
            await task
        yield task
    finally:
        task.cancel()
        await asyncio.wait({task})
