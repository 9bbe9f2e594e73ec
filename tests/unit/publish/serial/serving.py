"""A publisher that serves a port as long as a test runs."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable

from altd.publish.serial.publisher import ConsolePublisher, TelegramPublisher

GONE = "the port is gone"


def lines(count: int) -> Callable[[bytes], bool]:
    return lambda data: data.count(b"\n") >= count


@contextlib.asynccontextmanager
async def serving(publisher: TelegramPublisher | ConsolePublisher) -> AsyncIterator[asyncio.Task[None]]:
    ready = asyncio.Event()
    task = asyncio.ensure_future(publisher.run(ready.set))
    await ready.wait()
    yield task
    task.cancel()
    await asyncio.wait({task})
