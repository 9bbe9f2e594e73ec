"""The zero from which controllers measure relative values: one for the unit, in memory alone.

The published values never change with it: a shifted number that is taken for an absolute one steers wrong.
"""

from __future__ import annotations

import math
import secrets

from altd.records import Measurement, Value
from altd.status.board import Board
from altd.status.event_log import EventKind, EventLog

_NUMBERS = 0xFFFF
"""Of a request that sets the zero: 0 to 0xFFFE, for 0xFFFF is *not known* in a register."""


class NoZeroError(Exception):
    """There is no measurement to take as the zero; the sentence says why."""


class Zero:
    """A measurement and the differences from it.

    Each zero is set by the number that ``next_number`` has then, so a request that is late, repeated or
    replayed sets nothing. ``first_number`` is drawn by chance: a request of an earlier session fails too.
    """

    def __init__(self, events: EventLog, first_number: int | None = None) -> None:
        self.measurement: Measurement | None = None
        """None: no zero was set since the daemon started."""
        self.count = 0
        """Zeros set since the daemon started."""
        self._first_number = secrets.randbelow(_NUMBERS) if first_number is None else first_number
        self._events = events

    @property
    def next_number(self) -> int:
        """The number by which the next zero is set."""
        return (self._first_number + self.count) % _NUMBERS

    def set(self, board: Board, by: str) -> None:
        """Take the measurement on the board as the zero; raises NoZeroError where it is not valid.

        What is on the board is valid only while it is fresh and, unless the unit rehearses, live. ``by`` is
        the interface that asked, for the events.
        """
        measurement = board.read()
        if measurement is None or not measurement.valid:
            raise NoZeroError("the measurement is not valid")
        self.measurement = measurement
        self.count += 1
        self._events.note(EventKind.REQUEST, f"zero {self.count} was set", by)

    def difference(self, key: str, measurement: Measurement | None) -> Value | None:
        """A quantity of ``measurement`` less that of the zero; None: one of the two is not known.

        Its sigma takes the two as independent. Both share the calibration's errors, which cancel the better
        the nearer the two are to each other: the true standard deviation is then smaller.
        """
        if measurement is None or self.measurement is None:
            return None
        now, then = measurement.values.get(key), self.measurement.values.get(key)
        if now is None or then is None:
            return None
        sigma = None if now.sigma is None or then.sigma is None else math.hypot(now.sigma, then.sigma)
        return Value(now.value - then.value, sigma)
