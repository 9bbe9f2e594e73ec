"""The columns that a file has for quantities, and those that it gets: a quantity's number never changes."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterator, Sequence

from altd.history.columns import Column
from altd.history.schema import (
    MAX_COLUMNS,
    MEASUREMENT_PARTS,
    SUMMARIES,
    SUMMARY_PARTS,
    UnusableFileError,
    column_name,
)

_KEY = re.compile(r"(?:[a-z][a-z0-9_]*\.)?[a-z][a-z0-9_]*")
_MAX_CHARACTERS = 80


def prepare_columns(connection: sqlite3.Connection, columns: Sequence[Column]) -> list[int]:
    """The number of each column, which the tables hold from now on; inside of a transaction.

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
            _add(connection, "measurements", MEASUREMENT_PARTS, number)
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


def columns_in(connection: sqlite3.Connection) -> dict[int, Column]:
    """The quantities of a file by their numbers: of those with one key the newest."""
    return {number: column for _, (number, column) in {c.key: (n, c) for n, c in _rows(connection)}.items()}


def _rows(connection: sqlite3.Connection) -> Iterator[tuple[int, Column]]:
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
        yield number, Column(key, unit, decimals, label, bool(is_summarised), bool(is_from_sensor))


def _add(connection: sqlite3.Connection, table: str, parts: tuple[str, ...], number: int) -> None:
    for part in parts:
        connection.execute(f"ALTER TABLE {table} ADD COLUMN {column_name(part, number)} INTEGER")
