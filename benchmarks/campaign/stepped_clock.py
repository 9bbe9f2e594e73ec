"""A clock that the campaign drives: minutes of a daemon's life pass in as many steps as there are frames."""

from __future__ import annotations

import asyncio
import heapq
from datetime import UTC, datetime, timedelta
from itertools import count

from altd.ports import Stop

_START = datetime(2026, 11, 20, 8, 0, tzinfo=UTC)
_TURNS = 6
"""Turns of the loop in which every task that was woken reaches its next wait."""


class SteppedClock:
    """Behind ``altd.ports.Clock``; time stands still until it is set."""

    def __init__(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self._sleepers: list[tuple[int, int, asyncio.Future[None]]] = []
        self._number = count()

    def monotonic_ns(self) -> int:
        """Where time was set to."""
        return self._now_ns

    def utc(self, t_ns: int) -> datetime:
        """UTC of a monotonic instant."""
        return _START + timedelta(microseconds=t_ns / 1000)

    async def sleep(self, seconds: float) -> None:
        """Wait until time was set so far."""
        future = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (self._now_ns + round(seconds * 1e9), next(self._number), future))
        await future

    def wait(self, stop: Stop, seconds: float) -> None:
        """No thread of the campaign waits."""
        raise NotImplementedError

    async def pass_to(self, t_ns: int, *, at_one_blow: bool = False) -> None:
        """Let time pass; sleepers wake one after the other, or all at the end when the process was held."""
        await self.settle()
        while self._sleepers and self._sleepers[0][0] <= t_ns:
            due_ns, _, future = heapq.heappop(self._sleepers)
            self._now_ns = t_ns if at_one_blow else max(due_ns, self._now_ns)
            if not future.done():
                future.set_result(None)
            await self.settle()
        self._now_ns = max(t_ns, self._now_ns)

    async def settle(self) -> None:
        """Let every task run until it waits."""
        for _ in range(_TURNS):
            await asyncio.sleep(0)
