"""The zero of relative values for controllers: one for the unit, in memory only.

The published values never change with it: a controller that takes a shifted number for an absolute one would
steer wrong.
"""

from __future__ import annotations

import math
import secrets
from dataclasses import dataclass

from altd.records import Measurement, Value
from altd.status.board import Board
from altd.status.event_log import EventKind, EventLog

_NUMBERS = 0xFFFF
"""Count of numbers in a request that sets the zero: 0 to 0xFFFE; 0xFFFF is *not known* in a register."""


class NoZeroError(Exception):
    """There is no measurement to use as the zero; the message gives the reason."""


@dataclass(frozen=True, slots=True)
class ZeroState:
    """A measurement used as zero, and differences from it."""

    measurement: Measurement | None
    """Measurement used as zero; None: no zero was set since the daemon started."""
    count: int
    """Number of zeros set since the daemon started."""
    next_number: int
    """Number with which the next zero is set."""
    by: str = ""
    """Interface and client that requested it; empty: no zero was set."""

    def difference(self, key: str, measurement: Measurement | None) -> Value | None:
        """Return a quantity of ``measurement`` minus that of the zero; None: one of the two is not known.

        Its sigma treats the two as independent. Both share the calibration's errors, which cancel better the
        closer the two are: the true standard deviation is then smaller.
        """
        if measurement is None or self.measurement is None:
            return None
        now, then = measurement.values.get(key), self.measurement.values.get(key)
        if now is None or then is None:
            return None
        sigma = None if now.sigma is None or then.sigma is None else math.hypot(now.sigma, then.sigma)
        return Value(now.value - then.value, sigma)


class Zero:
    """Sets the zero.

    A zero is set only with the present ``next_number``, so a late, repeated or replayed request sets nothing.
    ``first_number`` is random: a request of an earlier session fails too.
    """

    def __init__(self, events: EventLog, first_number: int | None = None) -> None:
        first_number = secrets.randbelow(_NUMBERS) if first_number is None else first_number
        self.state = ZeroState(None, 0, first_number)
        self._events = events

    def set(self, board: Board, by: str) -> None:
        """Use the board's measurement as the zero; raises NoZeroError if it is not valid.

        The board's measurement is valid only while it is fresh and, unless in rehearsal, live. ``by`` is the
        requesting interface, for the events.
        """
        measurement = board.read()
        if measurement is None or not measurement.valid:
            raise NoZeroError("the measurement is not valid")
        count, next_number = self.state.count + 1, (self.state.next_number + 1) % _NUMBERS
        self.state = ZeroState(measurement, count, next_number, by)
        self._events.note(EventKind.REQUEST, f"zero {count} was set", by)
