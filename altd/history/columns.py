"""Columns of the history and their storage in its file.

A column is named after its quantity's number in the file, never after its key. NULL means not known. SQLite
stores a whole number in as many bytes as it needs: 110 mm in steps of 0.0001 mm takes three, a sigma one, a
correlation two.
"""

from __future__ import annotations

import math
import re
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

from altd.history.schema import (
    MAX_COLUMNS,
    MEASUREMENT_PARTS,
    SUMMARIES,
    SUMMARY_PARTS,
    UnusableFileError,
    column_name,
)
from altd.records import Measurement, Quantities, Quantity

_CORRELATION_DECIMALS = 4
_MAX_UNITS = 2**53
"""Limit of exact whole numbers in a float; no quantity of a unit comes near it."""


@dataclass(frozen=True, slots=True)
class StoredColumn:
    """A quantity as stored in a file, or the correlation of the errors of two.

    ``key`` is the key of a unit's quantity, or ``TARGET.KEY``. ``is_summarised``: the summaries contain it
    too; ``is_from_sensor``: it may be known while the measurement is invalid. A correlation has no unit.
    """

    key: str
    unit: str
    decimals: int
    label: str
    is_summarised: bool
    is_from_sensor: bool

    @property
    def identity(self) -> tuple[str, str, int]:
        """Key, unit and decimals; a change of any of them changes the meaning of the stored numbers."""
        return self.key, self.unit, self.decimals

    @property
    def parts(self) -> tuple[str, ...]:
        """Parts of a measurement that are stored: a correlation has no sigma."""
        return MEASUREMENT_PARTS if self.unit else MEASUREMENT_PARTS[:1]

    def steps(self, value: float | None) -> int | None:
        """Return a value as a whole number of steps of its last decimal; None: not known or not finite."""
        if value is None or not math.isfinite(value):
            return None
        steps = round(value * 10**self.decimals)
        return steps if abs(steps) < _MAX_UNITS else None

    def value(self, steps: float | None) -> float | None:
        """Return the value of a number of steps; a mean may contain fractions of a step."""
        return None if steps is None else round(steps / 10**self.decimals, self.decimals)


def columns_of(quantities: Quantities, targets: Iterable[str]) -> tuple[StoredColumn, ...]:
    """Return the columns of a unit: all of its quantities, those of its targets, then the correlations.

    Summaries contain the displayed quantities: no repetition in another unit and no quantity of a sensor that
    is not fitted. The covariance follows from correlations and sigmas; roll has no correlation with others.
    """
    shown = {quantity.key for quantity in quantities.shown}
    of_unit = [_column(quantity, "", quantity.key in shown) for quantity in quantities.of_unit]
    of_targets = [
        _column(quantity, f"{target}.", False) for target in targets for quantity in quantities.of_target
    ]
    by_key = {quantity.key: quantity for quantity in quantities.of_unit}
    joint = [by_key[key].is_also or key for key in quantities.joint if key in by_key]
    of_pairs = [_correlation(*pair) for pair in combinations(joint, 2)]
    return (*of_unit, *of_targets, *of_pairs)


def _correlation(one: str, other: str) -> StoredColumn:
    label = f"correlation of {one} and {other}"
    return StoredColumn(_pair_key(one, other), "", _CORRELATION_DECIMALS, label, False, False)


def correlations_of(measurement: Measurement) -> dict[str, float]:
    """Return the correlations of a measurement's errors by the keys of their columns; empty if not known."""
    if (joint := measurement.joint) is None:
        return {}
    rows = joint.covariance.tolist()
    return {
        _pair_key(joint.keys[one], joint.keys[other]): rows[one][other] / scale
        for one, other in combinations(range(len(rows)), 2)
        if (scale := math.sqrt(max(rows[one][one] * rows[other][other], 0.0))) > 0.0
    }


def _pair_key(one: str, other: str) -> str:
    return f"correlation_{one}_{other}"


def _column(quantity: Quantity, prefix: str, is_summarised: bool) -> StoredColumn:
    return StoredColumn(
        prefix + quantity.key,
        quantity.unit,
        quantity.decimals,
        quantity.label,
        is_summarised,
        quantity.is_from_sensor,
    )


_KEY = re.compile(r"(?:[a-z][a-z0-9_]*\.)?[a-z][a-z0-9_]*")
_MAX_CHARACTERS = 80


def prepare_columns(connection: sqlite3.Connection, columns: Sequence[StoredColumn]) -> list[int]:
    """Add missing columns to the tables and return the number of each column; call within a transaction.

    A quantity whose unit or decimals changed gets a new number. Raises UnusableFileError when there are too
    many.
    """
    known = {
        (key, unit, decimals): (int(number), bool(is_summarised))
        for number, key, unit, decimals, is_summarised in connection.execute(
            "SELECT number, key, unit, decimals, is_summarised FROM columns ORDER BY number"
        )
    }
    next_number = max((number for number, _ in known.values()), default=-1) + 1
    numbers = []
    for column in columns:
        number, was_summarised = known.get(column.identity, (next_number, False))
        if number == next_number:
            next_number += 1
            if number >= MAX_COLUMNS:
                raise UnusableFileError(f"has {MAX_COLUMNS} quantities already, and no room for more")
            _add(connection, "measurements", column.parts, number)
        if column.is_summarised and not was_summarised:
            for table in SUMMARIES:
                _add(connection, table.name, SUMMARY_PARTS, number)
        is_summarised = column.is_summarised or was_summarised
        connection.execute(
            "INSERT OR REPLACE INTO columns VALUES (?, ?, ?, ?, ?, ?, ?)",
            (number, *column.identity, column.label, is_summarised, column.is_from_sensor),
        )
        numbers.append(number)
    return numbers


def columns_in(connection: sqlite3.Connection) -> dict[int, StoredColumn]:
    """Return the quantities of a file by number; if several share a key, only the newest."""
    return {number: column for _, (number, column) in {c.key: (n, c) for n, c in _rows(connection)}.items()}


def _rows(connection: sqlite3.Connection) -> Iterator[tuple[int, StoredColumn]]:
    rows = connection.execute(
        "SELECT number, key, unit, decimals, label, is_summarised, is_from_sensor "
        "FROM columns ORDER BY number"
    )
    for number, key, unit, decimals, label, is_summarised, is_from_sensor in rows:
        words = (key, unit, label)
        if not all(isinstance(word, str) and len(word) <= _MAX_CHARACTERS for word in words):
            raise UnusableFileError("has a quantity without a name")
        if not isinstance(number, int) or not _KEY.fullmatch(key):
            raise UnusableFileError(f"has a quantity with the name {key!r}")
        if not isinstance(decimals, int) or not 0 <= decimals <= 12 or not 0 <= number < MAX_COLUMNS:
            raise UnusableFileError(f"has a quantity {key[:40]!r} that cannot be")
        yield number, StoredColumn(key, unit, decimals, label, bool(is_summarised), bool(is_from_sensor))


def _add(connection: sqlite3.Connection, table: str, parts: tuple[str, ...], number: int) -> None:
    for part in parts:
        connection.execute(f"ALTER TABLE {table} ADD COLUMN {column_name(part, number)} INTEGER")
