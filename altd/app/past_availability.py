"""What the history knows of the time before this start, for the unit's availability."""

from __future__ import annotations

import logging
from functools import partial

from altd.history.history import History, NoHistoryError
from altd.history.reader import Reader
from altd.history.running import before_start
from altd.ports import Clock
from altd.status.availability import MONTH_S, Availability, Before

log = logging.getLogger("altd")

LOOK_INTERVAL_S = 5.0
"""Longer than the history takes to write that the clock was set."""
CLOCK_STEP_US = 500_000


class PastAvailability:
    """Reads it at the start and whenever the time of day was set: by it the past is put in its place."""

    def __init__(self, history: History, availability: Availability, clock: Clock) -> None:
        self._history = history
        self._availability = availability
        self._clock = clock

    async def run(self) -> None:
        """Read until cancelled. While the history cannot be read, what was read last stands."""
        read_us: int | None = None
        seen_us = self._start_us()
        while True:
            start_us = self._start_us()
            if _is_same(start_us, seen_us) and not _is_same(start_us, read_us) and start_us is not None:
                try:
                    self._availability.before = await self._history.ask(partial(_before, start_us))
                    read_us = start_us
                except NoHistoryError:  # its component says why; it is asked again
                    log.debug("availability: the history before this start cannot be read now")
                except Exception:  # whatever is wrong with it, it must not end the measurement
                    log.exception("availability: a defect")
                    return
            seen_us = start_us
            await self._clock.sleep(LOOK_INTERVAL_S)

    def _start_us(self) -> int | None:
        """UTC of this start by the clock as it is now, µs; None: the clock is not known."""
        now_ns = self._clock.monotonic_ns()
        utc = self._clock.utc(now_ns)
        if utc is None:
            return None
        return round(utc.timestamp() * 1e6) - (now_ns - self._availability.started_ns) // 1000


def _before(start_us: int, reader: Reader) -> Before:
    return before_start(reader, start_us, MONTH_S)


def _is_same(start_us: int | None, other_us: int | None) -> bool:
    return start_us is not None and other_us is not None and abs(start_us - other_us) <= CLOCK_STEP_US
