"""Facts of the unit in a history's file, its epochs, and the codes of reasons."""

from __future__ import annotations

import json
import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from altd.history.records import Notice
from altd.history.schema import SEVERITY_UNIT, ForeignFileError
from altd.history.summary import WorstFault
from altd.status.event_log import EventKind

_KINDS = {
    "config": (EventKind.CONFIG, "the settings have changed"),
    "calibration": (EventKind.CALIBRATION, "the calibration has changed"),
    "version": (EventKind.VERSION, "the program has changed"),
}
_MAX_CHANGES = 10
_MAX_CHARACTERS = 60


def check_unit(connection: sqlite3.Connection, facts: Mapping[str, str]) -> None:
    """Raise ForeignFileError for a history of another unit: its measurements are not this unit's past."""
    found = connection.execute("SELECT value FROM facts WHERE name = 'serial'").fetchone()
    serial = facts.get("serial")
    if found is not None and serial is not None and found[0] != serial:
        raise ForeignFileError(f"is of unit {found[0]!r}, and this one is {serial!r}")


def changed_facts(connection: sqlite3.Connection, facts: Mapping[str, str]) -> list[Notice]:
    """Compare the facts with those in the file and store the new ones; call within a transaction."""
    before = dict(connection.execute("SELECT name, value FROM facts"))
    notices = []
    for name, value in facts.items():
        connection.execute("INSERT OR REPLACE INTO facts VALUES (?, ?)", (name, value))
        if name in before and before[name] != value and name in _KINDS:
            kind, text = _KINDS[name]
            notices.append(Notice(kind, text, _difference(before[name], value)))
    return notices


def _difference(before: str, after: str) -> dict[str, object]:
    """Return the changed keys of a JSON document, or both texts if they are not JSON documents."""
    try:
        old, new = (dict(_leaves(json.loads(text), "")) for text in (before, after))
    except (ValueError, TypeError, RecursionError):
        return {"before": _shown(before), "after": _shown(after)}
    changed = [key for key in {**old, **new} if old.get(key, "") != new.get(key, "")]
    shown: dict[str, object] = {
        key: [_shown(old.get(key, "")), _shown(new.get(key, ""))] for key in changed[:_MAX_CHANGES]
    }
    if len(changed) > _MAX_CHANGES:
        shown["more"] = len(changed) - _MAX_CHANGES
    return {"changed": shown}


def _leaves(node: Any, place: str) -> Iterator[tuple[str, str]]:
    if isinstance(node, dict):
        for key, below in node.items():
            yield from _leaves(below, f"{place}.{key}" if place else key)
    elif isinstance(node, list):
        for number, below in enumerate(node):
            yield from _leaves(below, f"{place}.{number}")
    else:
        yield place, json.dumps(node)


def _shown(text: str) -> str:
    return text if len(text) <= _MAX_CHARACTERS else f"{text[:_MAX_CHARACTERS]}…"


class Epochs:
    """Epochs of one open file. ``was_interrupted``: the last epoch in the file has no end."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        last = connection.execute(
            "SELECT epoch, ended_us, last_s FROM epochs ORDER BY epoch DESC LIMIT 1"
        ).fetchone()
        self.number = 0 if last is None else int(last[0])
        self.was_interrupted = last is not None and last[1] is None
        self.last_s: int | None = None if last is None else last[2]
        """Last second of the newest epoch."""
        self.began_ns = 0
        self._first_s: int | None = None
        self._new: Counter[str] = Counter()

    def begin(self, why: str, wall_us: int, now_ns: int) -> None:
        """Begin the next epoch, inside of a transaction."""
        self.number += 1
        self._connection.execute(
            "INSERT INTO epochs (epoch, why, began_us) VALUES (?, ?, ?)", (self.number, why, wall_us)
        )
        self._connection.execute(  # epochs of repeated crashes are deleted once their rows are gone
            "DELETE FROM epochs WHERE seconds = 0 AND minutes = 0 AND hours = 0 AND epoch < ?", (self.number,)
        )
        self.began_ns, self._first_s, self.last_s = now_ns, None, None

    def covering(self, t_s: int) -> int:
        """Extend the epoch to include this second and return the second."""
        self._first_s = t_s if self._first_s is None else min(self._first_s, t_s)
        self.last_s = t_s if self.last_s is None else max(self.last_s, t_s)
        return t_s

    def count(self, table: str, new: int) -> None:
        """Count ``new`` rows added to a table."""
        self._new[table] += new

    def save(self) -> None:
        """Write the changes; call within a transaction."""
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
        """End the epoch; None: the clock was set, so the epoch ends with its last second."""
        self.save()
        ended_us = (self.last_s or 0) * 10**6 if wall_us is None else wall_us
        self._connection.execute("UPDATE epochs SET ended_us = ? WHERE epoch = ?", (ended_us, self.number))


_MAX_REASONS = 1000
_OTHER = "other"


class Reasons:
    """Codes of reasons in one open file; a new code gets the next number."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._numbers: dict[str, int] = dict(connection.execute("SELECT code, number FROM reasons"))

    def number_of(self, fault: WorstFault) -> int:
        """Return the number in the file for a severity and its code; call within a transaction."""
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
    """Return the severity and the code for a number in the file."""
    if not isinstance(number, int) or number < 0:
        return 0, ""
    return min(number // SEVERITY_UNIT, 4), codes.get(number % SEVERITY_UNIT, "")


def codes_in(connection: sqlite3.Connection) -> dict[int, str]:
    """Return the codes of a file by number."""
    return {number: str(code) for number, code in connection.execute("SELECT number, code FROM reasons")}
