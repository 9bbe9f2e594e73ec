"""The system's clock as an implementation of the clock port."""

from __future__ import annotations

import asyncio
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

from altd.ports import Stop

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_AT_ONCE_NS = 50_000  # between two clocks' readings: under a microsecond if nothing suspends the thread
_READINGS = 10


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
        """Return the UTC of a monotonic instant; it changes when the system's clock is set.

        A thread that is suspended between its readings of the two clocks would shift the result by
        milliseconds, and with it the time of a whole recording. It reads them again then.
        """
        readings = []
        for _ in range(_READINGS):
            before_ns, utc_ns, after_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
            readings.append((after_ns - before_ns, utc_ns - (before_ns + after_ns) // 2))
            if after_ns - before_ns < _AT_ONCE_NS:
                break
        _, offset_ns = min(readings)
        return _EPOCH + timedelta(microseconds=(offset_ns + t_ns) // 1000)

    async def sleep(self, seconds: float) -> None:
        """Sleep in the event loop."""
        await asyncio.sleep(seconds)

    def wait(self, stop: Stop, seconds: float) -> None:
        """Block a thread for ``seconds``, or until ``stop`` is set."""
        stop.wait(seconds)
