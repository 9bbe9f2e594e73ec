"""The system's clock behind the clock port."""

from __future__ import annotations

import asyncio
import time
from datetime import UTC, datetime, timedelta

from altd.ports import Stop


class SystemClock:
    """CLOCK_MONOTONIC for arithmetic; UTC as the system knows it at the time of asking."""

    def monotonic_ns(self) -> int:
        """Nanoseconds of the monotonic clock."""
        return time.monotonic_ns()

    def utc(self, t_ns: int) -> datetime:
        """UTC of a monotonic instant; follows the system's clock when that is set."""
        return datetime.now(UTC) - timedelta(microseconds=(time.monotonic_ns() - t_ns) / 1000)

    async def sleep(self, seconds: float) -> None:
        """Sleep in the event loop."""
        await asyncio.sleep(seconds)

    def wait(self, stop: Stop, seconds: float) -> None:
        """Block a thread, at the most until ``stop`` is set."""
        stop.wait(seconds)
