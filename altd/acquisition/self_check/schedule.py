"""Determines when the next check is due, and its cause."""

from __future__ import annotations

import asyncio
from enum import StrEnum

from altd.ports import Clock

REST_S = 5.0
"""Minimum time between two checks, even on request: each takes exposures from the measurement."""
FIRST_REPEAT_S = 10.0
"""Time after which a check that is not good is first repeated; the intervals then grow."""


class Cause(StrEnum):
    """Cause of a check."""

    START = "start"
    SCHEDULE = "schedule"
    REQUEST = "request"
    SHOCK = "shock"
    REPEAT = "repeat"


class Schedule:
    """Schedule of checks: at the start, every ``interval_s``, and soon after a request or shock.

    Without ``automatic``, checks are made only on request.
    """

    def __init__(self, clock: Clock, interval_s: float, automatic: bool) -> None:
        self._clock = clock
        self._interval_s = interval_s
        self._automatic = automatic
        self._ended_ns: int | None = None
        """End of the last check by the monotonic clock; None: no check yet."""
        self._repeat_s: float | None = None
        self._requested: Cause | None = None
        self._changed = asyncio.Event()

    def ask(self, cause: Cause) -> None:
        """Request a check as soon as possible; without ``automatic``, a shock is ignored."""
        if cause is Cause.SHOCK and not self._automatic:
            return
        if self._requested is None or (cause is Cause.REQUEST and self._requested is not cause):
            self._requested = cause
            self._changed.set()  # once only: a flood of requests must not wake the task each time

    def ended(self, is_good: bool) -> None:
        """Note that a check has ended now; a check that is not good is repeated."""
        self._ended_ns = self._clock.monotonic_ns()
        if is_good:
            self._repeat_s = None
        else:
            self._repeat_s = min(2 * self._repeat_s if self._repeat_s else FIRST_REPEAT_S, self._interval_s)

    async def next(self) -> Cause:
        """Wait until a check is due; return its cause."""
        while True:
            self._changed.clear()
            cause, in_s = self._earliest()
            if cause is not None and in_s <= 0:
                self._requested = None
                return cause
            waiting: list[asyncio.Future[object]] = [asyncio.ensure_future(self._changed.wait())]
            if cause is not None:
                waiting.append(asyncio.ensure_future(self._clock.sleep(in_s)))
            try:
                await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for each in waiting:
                    each.cancel()
                await asyncio.gather(*waiting, return_exceptions=True)

    def _earliest(self) -> tuple[Cause | None, float]:
        """Return the cause of the next check (None: none is due), and the time until then in seconds."""
        if self._ended_ns is None:
            if self._requested is not None or self._automatic:
                return self._requested or Cause.START, 0.0
            return None, 0.0
        since_s = (self._clock.monotonic_ns() - self._ended_ns) * 1e-9
        if self._requested is not None:
            return self._requested, REST_S - since_s
        if not self._automatic:
            return None, 0.0
        if self._repeat_s is not None:
            return Cause.REPEAT, self._repeat_s - since_s
        return Cause.SCHEDULE, self._interval_s - since_s
