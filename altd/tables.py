"""Tables for other programs, one row per result, with names, types, units: JSON lines, CSV and Parquet.

Names end in their unit, an unknown value is absent, and every format has the same numbers. Parquet needs
pyarrow, the extra ``parquet``.
"""

from __future__ import annotations

import csv
import importlib
import io
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, Self

from altd.errors import BadInputError, escaped
from altd.files.documents import line_of
from altd.files.writing import replacing
from altd.records import Quantities, Quantity
from altd.records.measurement import UNITS_OF_PRODUCTS

if TYPE_CHECKING:
    import pyarrow


Value = int | float | bool | str | None
"""Value of a cell; None: not known."""
Row = Mapping[str, Value]
"""Values by the names of their columns."""
Add = Callable[[Row], object]
Write = Callable[[str], object]


class Type(StrEnum):
    """Type of a column's values."""

    WHOLE = "whole number"
    NUMBER = "number"
    TRUTH = "true or false"
    TEXT = "text"
    TIME = "time"


@dataclass(frozen=True, slots=True)
class Column:
    """A column; its name ends in the unit, if there is one."""

    name: str
    type: Type
    unit: str
    meaning: str


def number(name: str, meaning: str) -> Column:
    """Return a column of numbers, with the unit that ends its name."""
    return Column(name, Type.NUMBER, _unit(name), meaning)


def text(name: str, meaning: str) -> Column:
    """Return a column of text."""
    return Column(name, Type.TEXT, "", meaning)


_UNITS = {"_mm_per_m": "mm/m", "_mm": "mm", "_deg": "°", "_px": "px", "_s": "s", "_m": "m"}


def _unit(name: str) -> str:
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), "")


def measurement_columns(quantities: Quantities, targets: Sequence[str], of_scan: bool) -> tuple[Column, ...]:
    """Return the columns of a table of measurements, for the rows of ``flat_row``."""
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
        *(
            Column(
                name,
                Type.NUMBER,
                UNITS_OF_PRODUCTS[sum(quantities.joint[at].endswith("_per_m") for at in places)],
                "joint uncertainty of the two",
            )
            for name, *places in _covariances(quantities.joint)
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


def _covariances(joint: Sequence[str]) -> list[tuple[str, int, int]]:
    """Return the names of the columns of a covariance, with row and column of the matrix."""
    return [
        (f"covariance_{one}_{other}", row, row + more)
        for row, one in enumerate(joint)
        for more, other in enumerate(joint[row:])
    ]


def flat_row(document: Mapping[str, Any], joint: Sequence[str] = ()) -> dict[str, Value]:
    """Return a measurement's object as a row: ``sigma.x_mm`` becomes ``sigma_x_mm``.

    Likewise ``front.x_mm`` becomes ``front_x_mm``; ``targets.t1.x_mm`` of a row of targets becomes
    ``t1_x_mm``. ``joint`` names the rows of ``covariance``.
    """
    row: dict[str, Value] = {}
    for key, value in document.items():
        if key == "targets":
            row |= flat_row(value)
        elif key == "covariance":
            row |= {name: value[one][other] for name, one, other in _covariances(joint)}
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
"""Columns of ``altd locate``, in the order of its JSON objects."""

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
"""Columns of ``altd map``."""

AXIS_COLUMNS = (
    Column("line", Type.WHOLE, "", "number of the input line"),
    Column("sequence", Type.WHOLE, "", "of the measurement"),
    Column("time", Type.TIME, "", "of the measurement"),
    text("status", "codes of the measurement; `simulated` and `playback` are not live"),
    text("point", "name of the point of the machine"),
    number("chainage_m", "place of the point's foot on the axis"),
    number("offset_right_mm", "horizontal distance of the point from the axis, positive to the right"),
    number("offset_up_mm", "vertical distance of the point from the axis, positive above"),
    number("sigma_chainage_mm", "combined standard uncertainty"),
    number("sigma_offset_right_mm", "combined standard uncertainty"),
    number("sigma_offset_up_mm", "combined standard uncertainty"),
    number("east_m", "the point in the project"),
    number("north_m", "the point in the project"),
    number("height_m", "the point in the project"),
    number("sigma_east_mm", "combined standard uncertainty"),
    number("sigma_north_mm", "combined standard uncertainty"),
    number("sigma_height_mm", "combined standard uncertainty"),
    text("reason", "why there are no numbers; `unreadable`: the line is no measurement"),
    text("detail", "the same in words"),
)
"""Columns of ``altd axis``."""


class CsvTable:
    """A header of names, then one line per row, with CRLF line ends; an unknown value is an empty field.

    Text is escaped, so that a row is one line. JSON has the exact text.
    """

    def __init__(self, write: Write, columns: Sequence[Column]) -> None:
        self._names = [column.name for column in columns]
        self._lines = csv.writer(_Lines(write))
        self._lines.writerow(self._names)

    def add(self, row: Row) -> None:
        """Write a row; a missing value is empty."""
        self._lines.writerow([_csv_field(row.get(name)) for name in self._names])


class JsonTable:
    """One object per line; an unknown value is null."""

    def __init__(self, write: Write, columns: Sequence[Column]) -> None:
        self._write = write
        self._names = [column.name for column in columns]

    def add(self, row: Row) -> None:
        """Write a row; a missing value is null."""
        self._write(line_of({name: row.get(name) for name in self._names}) + "\n")


TextFormat = Literal["jsonl", "csv"]
Format = Literal["jsonl", "csv", "parquet"]
TEXT_FORMATS: dict[TextFormat, type[CsvTable] | type[JsonTable]] = {"jsonl": JsonTable, "csv": CsvTable}


class _Lines:
    """The part of a file that ``csv`` needs."""

    def __init__(self, write: Write) -> None:
        self.write = write


def _csv_field(value: Value) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return escaped(str(value))


MAX_ROWS_HELD = 8192
"""Maximum number of rows in a row group, which is kept in memory: 2 MB."""


def check_parquet(output: Path | None) -> None:
    """Check before any work is done that there are an output file and pyarrow; raises BadInputError."""
    if output is None:
        raise BadInputError("--format parquet", "needs a file: -o FILE")
    try:
        importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise BadInputError(
            "--format parquet", "needs pyarrow, which comes with the extra altd[parquet]"
        ) from error


class _Sink(io.RawIOBase):
    """A file that accepts writes and, once it is closed, discards them.

    pyarrow's writer writes its footer when it is destroyed, even after a signal or a full disk has ended the
    work; that must not raise.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        return len(data) if self._file.closed else self._file.write(data)


class ParquetTable:
    """Writes rows to an open file; ``about`` becomes the file's metadata, each value as JSON.

    A column's unit and meaning are in the metadata of its field.
    """

    def __init__(self, file: BinaryIO, columns: Sequence[Column], about: Mapping[str, Any]) -> None:
        import pyarrow.parquet

        self._schema = pyarrow.schema(
            [_parquet_field(column) for column in columns],
            {f"altd.{key}": json.dumps(value, allow_nan=False) for key, value in about.items()},
        )
        self._times = [column.name for column in columns if column.type is Type.TIME]
        self._rows: list[dict[str, Any]] = []
        sink = _Sink(file)
        self._writer = pyarrow.parquet.ParquetWriter(sink, self._schema, compression="snappy", version="2.6")

    def add(self, row: Row) -> None:
        """Write a row; a missing value is null."""
        times = {name: _moment(row.get(name)) for name in self._times}
        self._rows.append({**row, **times})
        if len(self._rows) >= MAX_ROWS_HELD:
            self._flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Write the remaining rows and the footer, without which the file is not Parquet."""
        if kind is None:
            if self._rows:
                self._flush()
            self._writer.close()

    def _flush(self) -> None:
        import pyarrow

        self._writer.write_table(pyarrow.Table.from_pylist(self._rows, self._schema))
        self._rows.clear()


def _parquet_field(column: Column) -> pyarrow.Field:
    import pyarrow

    types = {
        Type.WHOLE: pyarrow.int64(),
        Type.NUMBER: pyarrow.float64(),
        Type.TRUTH: pyarrow.bool_(),
        Type.TEXT: pyarrow.string(),
        Type.TIME: pyarrow.timestamp("ms", tz="UTC"),
    }
    about = {"meaning": column.meaning} | ({"unit": column.unit} if column.unit else {})
    return pyarrow.field(column.name, types[column.type], metadata=about)


def _moment(text: object) -> datetime | None:
    return None if text is None else datetime.fromisoformat(str(text))


@contextmanager
def text_output(path: Path | None) -> Iterator[Write]:
    """Yield a function that writes to standard output, or to a file replaced after the last write."""
    if path is None:
        yield sys.stdout.write
        return
    with replacing(path) as file:
        yield lambda text: file.write(text.encode())


@contextmanager
def table_in(
    path: Path | None, form: Format, columns: Sequence[Column], about: Mapping[str, Any]
) -> Iterator[Add]:
    """Yield a function that adds rows on standard output, or to a file replaced after the last row."""
    if form != "parquet":
        with text_output(path) as write:
            yield TEXT_FORMATS[form](write, columns).add
    elif path is not None:
        with replacing(path) as file, ParquetTable(file, columns, about) as table:
            yield table.add
