"""A clock that a test drives: an hour passes in as many steps as there are sleepers."""

from __future__ import annotations

import asyncio
import heapq
from datetime import UTC, datetime, timedelta
from itertools import count

START = datetime(2026, 11, 20, 8, 0, tzinfo=UTC)


class FakeClock:
    """Time stands still until ``advance`` lets it pass."""

    def __init__(self, now_ns: int = 0) -> None:
        self.now_ns = now_ns
        self._sleepers: list[tuple[int, int, asyncio.Future[None]]] = []
        self._number = count()

    def monotonic_ns(self) -> int:
        return self.now_ns

    def utc(self, t_ns: int) -> datetime:
        return START + timedelta(microseconds=t_ns / 1000)

    async def sleep(self, seconds: float) -> None:
        future = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (self.now_ns + round(seconds * 1e9), next(self._number), future))
        await future

    async def advance(self, seconds: float) -> None:
        """Let time pass, waking sleepers in order; each has its say before the next one wakes."""
        end_ns = self.now_ns + round(seconds * 1e9)
        await settle()
        while self._sleepers and self._sleepers[0][0] <= end_ns:
            self.now_ns, _, future = heapq.heappop(self._sleepers)
            if not future.done():
                future.set_result(None)
            await settle()
        self.now_ns = end_ns

    async def jump(self, seconds: float) -> None:
        """Let time pass at one blow, as when the process was held: all that is due wakes at the end."""
        await settle()
        self.now_ns += round(seconds * 1e9)
        while self._sleepers and self._sleepers[0][0] <= self.now_ns:
            _, _, future = heapq.heappop(self._sleepers)
            if not future.done():
                future.set_result(None)
        await settle()


async def stop(task: asyncio.Task[None]) -> None:
    """Cancel a task and wait until it is gone."""
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    assert task.cancelled()


async def settle() -> None:
    """Let every task run until it waits."""
    for _ in range(10):
        await asyncio.sleep(0)
