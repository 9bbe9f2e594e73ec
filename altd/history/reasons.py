"""The codes of reasons and causes as a file numbers them."""

from __future__ import annotations

import sqlite3

from altd.history.schema import SEVERITY_UNIT
from altd.history.summary import Illness

_MAX_REASONS = 1000
_OTHER = "other"


class Reasons:
    """Of one open file; a new code gets the next number."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._numbers: dict[str, int] = dict(connection.execute("SELECT code, number FROM reasons"))

    def number_of(self, illness: Illness) -> int:
        """What stands in the file for a severity and its code; inside of a transaction."""
        severity, code = illness
        return severity * SEVERITY_UNIT + (self._number(code) if code else 0)

    def _number(self, code: str) -> int:
        if code not in self._numbers and len(self._numbers) >= _MAX_REASONS:
            code = _OTHER
        if code not in self._numbers:
            number = max(self._numbers.values(), default=0) + 1
            self._connection.execute("INSERT INTO reasons VALUES (?, ?)", (number, code))
            self._numbers[code] = number
        return self._numbers[code]


def illness_in(number: object, codes: dict[int, str]) -> Illness:
    """A severity and its code of what stands in the file."""
    if not isinstance(number, int) or number < 0:
        return 0, ""
    return min(number // SEVERITY_UNIT, 4), codes.get(number % SEVERITY_UNIT, "")


def codes_in(connection: sqlite3.Connection) -> dict[int, str]:
    """The codes of a file by their numbers."""
    return {number: str(code) for number, code in connection.execute("SELECT number, code FROM reasons")}
