"""The system's clock as an implementation of the clock port."""

from __future__ import annotations

import asyncio
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

from altd.ports import Stop


def time_zone(link: Path = Path("/etc/localtime")) -> str:
    """Return the IANA name of the computer's time zone, as tzset(3) and systemd know it.

    Empty: UTC, or not known because the file is missing or is no link.
    """
    try:
        _, is_known, name = str(link.readlink()).rpartition("/zoneinfo/")
    except OSError:
        return ""
    is_utc = name.rpartition("/")[2] in ("UTC", "UCT", "Universal", "Zulu")
    return "" if is_utc or not is_known else name


class SystemClock:
    """CLOCK_MONOTONIC for arithmetic; UTC by the system's clock at the time of the call."""

    def monotonic_ns(self) -> int:
        """Return the time of the monotonic clock, ns."""
        return time.monotonic_ns()

    def utc(self, t_ns: int) -> datetime:
        """Return the UTC of a monotonic instant; it changes when the system's clock is set."""
        return datetime.now(UTC) - timedelta(microseconds=(time.monotonic_ns() - t_ns) / 1000)

    async def sleep(self, seconds: float) -> None:
        """Sleep in the event loop."""
        await asyncio.sleep(seconds)

    def wait(self, stop: Stop, seconds: float) -> None:
        """Block a thread for ``seconds``, or until ``stop`` is set."""
        stop.wait(seconds)
