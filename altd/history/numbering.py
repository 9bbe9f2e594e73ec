"""The numbers in a history's file: its epochs from start to start, and the codes of reasons and causes."""

from __future__ import annotations

import sqlite3
from collections import Counter

from altd.history.schema import SEVERITY_UNIT
from altd.history.summary import WorstFault


class Epochs:
    """Of one open file. ``was_interrupted``: the last one that it holds was not ended."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        last = connection.execute(
            "SELECT epoch, ended_us, last_s FROM epochs ORDER BY epoch DESC LIMIT 1"
        ).fetchone()
        self.number = 0 if last is None else int(last[0])
        self.was_interrupted = last is not None and last[1] is None
        self.last_s: int | None = None if last is None else last[2]
        """The last second of the newest epoch."""
        self.began_ns = 0
        self._first_s: int | None = None
        self._new: Counter[str] = Counter()

    def begin(self, why: str, wall_us: int, now_ns: int) -> None:
        """Begin the next epoch, inside of a transaction."""
        self.number += 1
        self._connection.execute(
            "INSERT INTO epochs (epoch, why, began_us) VALUES (?, ?, ?)", (self.number, why, wall_us)
        )
        self._connection.execute(  # epochs of repeated crashes are not kept once their rows are gone
            "DELETE FROM epochs WHERE seconds = 0 AND minutes = 0 AND hours = 0 AND epoch < ?", (self.number,)
        )
        self.began_ns, self._first_s, self.last_s = now_ns, None, None

    def covering(self, t_s: int) -> int:
        """The same second, which this epoch holds from now on."""
        self._first_s = t_s if self._first_s is None else min(self._first_s, t_s)
        self.last_s = t_s if self.last_s is None else max(self.last_s, t_s)
        return t_s

    def count(self, table: str, new: int) -> None:
        """So many rows were added to a table."""
        self._new[table] += new

    def save(self) -> None:
        """Write what has changed, inside of a transaction."""
        self._connection.execute(
            "UPDATE epochs SET first_s = ?, last_s = ?, seconds = seconds + ?, minutes = minutes + ?, "
            "hours = hours + ? WHERE epoch = ?",
            (
                self._first_s,
                self.last_s,
                *(self._new[name] for name in ("seconds", "minutes", "hours")),
                self.number,
            ),
        )
        self._new.clear()

    def end(self, wall_us: int | None) -> None:
        """The epoch is over; None: the clock was set, so its end is its last second."""
        self.save()
        ended_us = (self.last_s or 0) * 10**6 if wall_us is None else wall_us
        self._connection.execute("UPDATE epochs SET ended_us = ? WHERE epoch = ?", (ended_us, self.number))


_MAX_REASONS = 1000
_OTHER = "other"


class Reasons:
    """Of one open file; a new code gets the next number."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._numbers: dict[str, int] = dict(connection.execute("SELECT code, number FROM reasons"))

    def number_of(self, fault: WorstFault) -> int:
        """The number in the file for a severity and its code; inside of a transaction."""
        severity, code = fault
        return severity * SEVERITY_UNIT + (self._number(code) if code else 0)

    def _number(self, code: str) -> int:
        if code not in self._numbers and len(self._numbers) >= _MAX_REASONS:
            code = _OTHER
        if code not in self._numbers:
            number = max(self._numbers.values(), default=0) + 1
            self._connection.execute("INSERT INTO reasons VALUES (?, ?)", (number, code))
            self._numbers[code] = number
        return self._numbers[code]


def fault_in(number: object, codes: dict[int, str]) -> WorstFault:
    """The severity and the code of a number in the file."""
    if not isinstance(number, int) or number < 0:
        return 0, ""
    return min(number // SEVERITY_UNIT, 4), codes.get(number % SEVERITY_UNIT, "")


def codes_in(connection: sqlite3.Connection) -> dict[int, str]:
    """The codes of a file by their numbers."""
    return {number: str(code) for number, code in connection.execute("SELECT number, code FROM reasons")}
