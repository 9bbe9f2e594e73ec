"""The board: the latest measurement, for any number of readers that never delay the writer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from altd.ports import Clock
from altd.reasons import NOT_FROM_CAMERAS, Reason
from altd.records import Fault, Finding, Measurement, Quantities
from altd.status.proof import Identity

_REHEARSAL = Finding((Fault(Reason.REHEARSAL),))


class Board:
    """Holds the latest measurement; each waiting reader has its own cursor, which counts skipped ones.

    ``sense`` returns the present values of other sensors, and what they show together with a measurement;
    ``finish`` adds what follows from both. Without ``rehearsal``, a measurement loses its numbers if its
    frames are played or simulated, or its calibration was made from simulated frames.
    """

    def __init__(  # noqa: PLR0913  what a measurement is finished by
        self,
        clock: Clock,
        stale_after_s: float,
        quantities: Quantities,
        identity: Identity = Identity(),  # noqa: B008  frozen; a board without an identity is of no unit
        sense: Callable[[Measurement], Finding] | None = None,
        rehearsal: bool = False,
        finish: Callable[[Measurement], Measurement] | None = None,
    ) -> None:
        self.quantities = quantities
        """Quantities of its measurements; known before the first one."""
        self.stale_after_s = stale_after_s
        self._sense = sense
        self._finish = finish or (lambda measurement: measurement)
        self.is_rehearsal = rehearsal
        """Whether numbers that are not live are valid."""
        self.identity = identity
        """Identity of the unit and session of these measurements."""
        self.messages: dict[str, int] = {}
        """Number of messages that each interface has sent in this session, by the interface's component."""
        self._clock = clock
        self._started_ns = clock.monotonic_ns()
        self._latest: Measurement | None = None
        self._stale: Measurement | None = None
        """Record shown once the latest is stale: always the same object, so that readers recognise it."""
        self._published_ns = 0
        self._count = 0
        self._changed = asyncio.Event()

    @property
    def published(self) -> int:
        """Number of measurements published so far."""
        return self._count

    def publish(self, measurement: Measurement, geometry: Finding | None = None) -> Measurement:
        """Finish a measurement, publish it and wake all waiting readers; returns it as published."""
        sensed = self._sense(measurement.with_findings(geometry)) if self._sense else None
        published = self._finish(measurement.with_findings(geometry, sensed, self._origin(measurement)))
        self._latest, self._stale = published, None
        self._published_ns = self._clock.monotonic_ns()
        self._count += 1
        self._changed.set()
        self._changed = asyncio.Event()
        return published

    def _origin(self, measurement: Measurement) -> Finding | None:
        """Return what follows from the source: without rehearsal, only live data have numbers."""
        if self.is_rehearsal:
            return _REHEARSAL
        why = [str(fault.reason) for fault in measurement.status if fault.reason in NOT_FROM_CAMERAS]
        not_live = Fault(Reason.NOT_LIVE, detail=" and ".join(why))
        return Finding((not_live,), withdraws=True) if why else None

    async def published_after(self, count: int) -> int:
        """Wait until the number of published measurements differs from ``count``; return that number."""
        while self._count == count:
            await self._changed.wait()
        return self._count

    def running_ns(self) -> int:
        """Return the nanoseconds since the board was created, at the daemon's start."""
        return self._clock.monotonic_ns() - self._started_ns

    def age_s(self) -> float | None:
        """Return the seconds since the middle of the latest measurement's window; None before the first."""
        if self._latest is None:
            return None
        return (self._clock.monotonic_ns() - self._latest.t_ns) * 1e-9

    def read(self) -> Measurement | None:
        """Return the latest measurement; without numbers and with ``stale`` once it is too old.

        Its age counts from its last exposure to light, not from its publication, so that delays on the way
        are included. Frames that are played faster than they were recorded are ahead of the clock; their
        measurements age from publication. Values of other sensors have their own age.
        """
        latest = self._latest
        if latest is None:
            return None
        now_ns = self._clock.monotonic_ns()
        if (shown := latest.at(now_ns)) is not latest:
            self._latest, self._stale = (latest := self._finish(shown)), None
        since_ns = min(self._published_ns, latest.light_ns)
        if now_ns - since_ns <= self.stale_after_s * 1e9:
            return latest
        if self._stale is None:
            self._stale = latest.without_numbers((*latest.status, Fault(Reason.STALE)))
        return self._stale

    def cursor(self) -> Cursor:
        """Return a reader's cursor; the current measurement counts as not yet read."""
        return Cursor(self)


class Cursor:
    """One reader's position on the board."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._seen = max(board.published - 1, 0)
        self.skipped = 0
        """Number of measurements that were replaced before this reader took them."""

    async def next(self) -> Measurement:
        """Return the latest measurement not yet read; wait for one if necessary."""
        published = await self._board.published_after(self._seen)
        self.skipped += published - self._seen - 1
        self._seen = published
        measurement = self._board.read()
        assert measurement is not None  # noqa: S101  the count is above zero
        return measurement
