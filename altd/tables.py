"""The columns of the tables: names, types, units and meanings; and tables as JSON lines and CSV."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Literal

from altd.errors import escaped
from altd.files.documents import line_of
from altd.records import Quantities, Quantity

Value = int | float | bool | str | None
"""The value of a cell; None: not known."""
Row = Mapping[str, Value]
"""Values by the names of their columns."""


class Type(StrEnum):
    """The type of a column's values."""

    WHOLE = "whole number"
    NUMBER = "number"
    TRUTH = "true or false"
    TEXT = "text"
    TIME = "time"


@dataclass(frozen=True, slots=True)
class Column:
    """A name that ends in the unit, where there is one."""

    name: str
    type: Type
    unit: str
    meaning: str


def number(name: str, meaning: str) -> Column:
    """A column of numbers, whose name tells their unit."""
    return Column(name, Type.NUMBER, _unit(name), meaning)


def text(name: str, meaning: str) -> Column:
    """A column of text."""
    return Column(name, Type.TEXT, "", meaning)


_UNITS = {"_mm_per_m": "mm/m", "_mm": "mm", "_deg": "°", "_px": "px", "_s": "s"}


def _unit(name: str) -> str:
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), "")


def measurement_columns(quantities: Quantities, targets: Sequence[str], of_scan: bool) -> tuple[Column, ...]:
    """The columns of a table of measurements, of which ``flat_row`` makes the rows."""
    columns = [
        Column("sequence", Type.WHOLE, "", "number of the last exposure in the window"),
        Column("time", Type.TIME, "", "UTC of the middle of the exposures that were averaged"),
        number("t_s", "the same, since the recording's start"),
        Column("frames", Type.WHOLE, "", "exposures that were averaged"),
        Column("valid", Type.TRUTH, "", "whether the numbers may be used"),
        text("status", "codes of reasons and warnings, with a space between them"),
        *(_of_quantity("", quantity, quantity.meaning) for quantity in quantities.of_unit),
        *(
            _of_quantity("sigma_", quantity, "combined standard uncertainty")
            for quantity in quantities.of_unit
            if quantity.has_sigma
        ),
        *(
            _of_quantity("sigma_random_", quantity, "the part of sigma that scatters")
            for quantity in quantities.of_unit
            if quantity.has_sigma
        ),
    ]
    for target in targets:
        columns += [
            _of_quantity(f"{target}_", quantity, f"{quantity.meaning} {target}")
            for quantity in quantities.of_target
        ]
    if of_scan:
        columns += [
            number(f"known_{axis}_mm", "position of the stage's beam, on every target") for axis in "xy"
        ]
        columns += [number(f"d{axis}_mm", "measured minus known") for axis in "xy"]
        for target in targets:
            columns += [
                number(f"{target}_d{axis}_mm", "measured minus known, on this target") for axis in "xy"
            ]
    return tuple(columns)


def _of_quantity(prefix: str, quantity: Quantity, meaning: str) -> Column:
    return Column(f"{prefix}{quantity.key}", Type.NUMBER, quantity.unit, meaning)


def flat_row(document: Mapping[str, Any]) -> dict[str, Value]:
    """A measurement's object as a row: ``sigma.x_mm`` is ``sigma_x_mm``, ``front.x_mm`` is ``front_x_mm``.

    Below ``targets``, that of a row of targets, the same: ``targets.t1.x_mm`` is ``t1_x_mm``.
    """
    row: dict[str, Value] = {}
    for key, value in document.items():
        if key == "targets":
            row |= flat_row(value)
        elif isinstance(value, Mapping):
            row |= {f"{key}_{inner}": of_inner for inner, of_inner in value.items()}
        elif isinstance(value, list):
            row[key] = " ".join(value)
        else:
            row[key] = value
    return row


SPOT_COLUMNS = (
    text("image", "the file as it was named"),
    number("u_px", "the spot, to the right of the centre of the first pixel"),
    number("v_px", "the spot, downwards"),
    number("sigma_px", "standard deviation by read and shot noise, of each axis"),
    number("diameter_px", "1/e² diameter"),
    Column("peak", Type.NUMBER, "counts", "brightness over the background"),
    text("reason", "why there is no spot; `unreadable`: no picture"),
    text("detail", "the same in words"),
    number("ellipse_u_px", "the spot by the second localiser"),
    number("ellipse_v_px", "the spot by the second localiser"),
    number("ellipse_sigma_px", "standard deviation of that by noise"),
    text("doubt", "why the position is doubtful; empty: it is not"),
)
"""Of ``altd locate``, in the order of its JSON objects."""

POINT_COLUMNS = (
    Column("line", Type.WHOLE, "", "number of the input line"),
    number("u_px", "as read"),
    number("v_px", "as read"),
    number("x_mm", "intersection of the beam with the target"),
    number("y_mm", "intersection of the beam with the target"),
    number("sigma_x_mm", "uncertainty by map, print and speckle"),
    number("sigma_y_mm", "uncertainty by map, print and speckle"),
    text("reason", "why there is no point; `unreadable`: the line is not `u v`"),
    text("origin", "`camera` or `simulated`: the calibration's frames"),
)
"""Of ``altd map``."""


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
    """The part of a file that ``csv`` needs."""

    def __init__(self, write: Write) -> None:
        self.write = write


def _field(value: Value) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return escaped(str(value))
