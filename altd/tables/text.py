"""Tables as text: JSON lines, and CSV by RFC 4180."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from typing import Literal

from altd.errors import escaped
from altd.files.documents import line_of
from altd.tables.columns import Column, Row, Value

Write = Callable[[str], object]


class CsvTable:
    """A header of names, then a line a row, CRLF at their ends; what is not known is an empty field.

    Text is escaped, so that a row is one line. JSON has the exact text.
    """

    def __init__(self, write: Write, columns: Sequence[Column]) -> None:
        self._names = [column.name for column in columns]
        self._lines = csv.writer(_Lines(write))
        self._lines.writerow(self._names)

    def add(self, row: Row) -> None:
        """A row; what it does not have is empty."""
        self._lines.writerow([_field(row.get(name)) for name in self._names])


class JsonTable:
    """An object a line; what is not known is null."""

    def __init__(self, write: Write, columns: Sequence[Column]) -> None:
        self._write = write
        self._names = [column.name for column in columns]

    def add(self, row: Row) -> None:
        """A row; what it does not have is null."""
        self._write(line_of({name: row.get(name) for name in self._names}) + "\n")


TextFormat = Literal["jsonl", "csv"]
TEXT_FORMATS: dict[TextFormat, type[CsvTable] | type[JsonTable]] = {"jsonl": JsonTable, "csv": CsvTable}


class _Lines:
    """What ``csv`` takes for a file."""

    def __init__(self, write: Write) -> None:
        self.write = write


def _field(value: Value) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return escaped(str(value))
