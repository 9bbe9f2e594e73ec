"""``frames.csv`` of a recording: one row for each frame, read again for each iteration."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Self

from altd.errors import BadInputError
from altd.files.reading import UnchangedFile

COLUMNS = ("sequence", "t_s", "camera", "file", "leds", "x_mm", "y_mm")
OPAQUE = "opaque"
"""Name of an optional column, for switched targets."""

MAX_T_S = 1e9
"""Maximum time, thirty years, s: the times of a recording count from its start."""
MAX_SEQUENCE = 2**53
"""Maximum sequence: whole numbers up to here are exact as floats, thus in every JSON reader."""
MAX_POSITION_MM = 10_000.0

POSE_COLUMNS = {"a_mm": MAX_POSITION_MM, "b_mm": MAX_POSITION_MM, "phi_deg": 360.0}
"""Names of further columns, for the known pose of a plate, each with its largest value."""
JOINT_COLUMNS = dict.fromkeys(("joint_1_mm", "joint_2_mm", "joint_3_mm"), MAX_POSITION_MM)
"""The same for the joints of the machine that moves the plate."""

_MAX_BYTES = 1 << 28
"""Maximum size of the table; a day of two cameras at 20 frames per second takes 210 MB."""


@dataclass(frozen=True, slots=True)
class FrameLine:
    """One line of ``frames.csv``; ``position_mm`` is the stage's position of the beam, if known.

    ``opaque`` names the target that was switched to show the spot; empty: none. ``pose`` is that of a plate,
    (a mm, b mm, φ °), ``joints_mm`` the place of the machine that moves it, if known.
    """

    number: int
    sequence: int
    t_s: float
    camera: str
    file: str
    leds_on: bool
    position_mm: tuple[float, float] | None
    opaque: str = ""
    pose: tuple[float, ...] | None = None
    joints_mm: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows of a table that has been checked, in its order.

    Each iteration reads the table again, so a day of frames takes no more memory than a second. It raises
    BadInputError if the table has changed since it was checked.
    """

    table: UnchangedFile
    count: Mapping[str, int]
    """Number of frames of each camera, 0 included."""
    first: FrameLine
    last: FrameLine
    largest_sequence: int
    has_positions: bool
    """Whether any row contains the stage's position of the beam."""
    has_opaque: bool = False
    """Whether any row names a target that was switched to show the spot."""

    @classmethod
    def checked(cls, path: Path, cameras: Collection[str], check: Callable[[FrameLine], None]) -> Self:
        """Read all rows of the cameras and ``check`` each; both may raise BadInputError."""
        table = UnchangedFile(path, _MAX_BYTES)
        count = Counter(dict.fromkeys(cameras, 0))
        largest_sequence, has_positions, has_opaque = 0, False, False
        first = last = None
        for row in _read_rows(table, cameras):
            check(row)
            first, last = first or row, row
            count[row.camera] += 1
            largest_sequence = max(largest_sequence, row.sequence)
            has_positions |= row.position_mm is not None
            has_opaque |= bool(row.opaque)
        if first is None or last is None:
            raise BadInputError(path, "has no frames")
        return cls(table, count, first, last, largest_sequence, has_positions, has_opaque)

    def __len__(self) -> int:
        return sum(self.count.values())

    def __iter__(self) -> Iterator[FrameLine]:
        return _read_rows(self.table, self.count)

    def of(self, camera: str) -> Iterator[FrameLine]:
        """Return an iterator over the rows of one camera."""
        return (row for row in self if row.camera == camera)

    def place(self, row: FrameLine) -> str:
        """Return the file and the number of the row, for an error message."""
        return f"{self.table.path}: row {row.number}"


def _read_rows(table: UnchangedFile, cameras: Collection[str]) -> Iterator[FrameLine]:
    path = table.path
    try:
        reader = csv.DictReader(table.lines(), strict=True)
        columns = list(reader.fieldnames or ())
        further = [group for group in (POSE_COLUMNS, JOINT_COLUMNS) if set(group) & set(columns)]
        for column in (*COLUMNS, *chain.from_iterable(further)):
            if columns.count(column) != 1:
                what = "is repeated" if column in columns else "is missing"
                what += "; columns are separated by commas" if len(columns) == 1 else ""
                raise BadInputError(f"{path}: row 1", f"column {column!r} {what}")
        if columns.count(OPAQUE) > 1:
            raise BadInputError(f"{path}: row 1", f"column {OPAQUE!r} is repeated")
        last: dict[str, FrameLine] = {}
        for record in reader:
            place = f"{path}: row {reader.line_num}"
            row = _read_row(place, reader.line_num, record, cameras)
            if (above := last.get(row.camera)) is not None:
                _check_order(place, above, row)
            last[row.camera] = row
            yield row
    except (csv.Error, UnicodeDecodeError) as error:
        raise BadInputError(path, f"is not CSV: {error}") from error


def _check_order(place: str, above: FrameLine, row: FrameLine) -> None:
    """Raise unless a camera's rows are in the order of their exposures, without repeated ones."""
    for column, value, before in (
        ("sequence", row.sequence, above.sequence),
        ("t_s", row.t_s, above.t_s),
    ):
        if value <= before:
            where = "that of" if value == before else "before"
            raise BadInputError(
                place, f"{column} {value} is {where} the camera's frame above it, row {above.number}"
            )


def _read_row(
    place: str, number: int, record: Mapping[str, str | None], cameras: Collection[str]
) -> FrameLine:
    if any(record[column] is None for column in COLUMNS) or record.get(OPAQUE, "") is None:
        raise BadInputError(place, f"is torn: {sum(v is not None for v in record.values())} fields")
    text = {column: str(record[column]).strip() for column in COLUMNS}
    if text["camera"] not in cameras:
        raise BadInputError(place, f"camera {text['camera']!r} is not in recording.json")
    if text["leds"] not in ("on", "off"):
        raise BadInputError(place, f"leds must be on or off, not {text['leds']!r}")
    if not text["file"] or Path(text["file"]).is_absolute() or ".." in Path(text["file"]).parts:
        raise BadInputError(place, f"file {text['file']!r} is not a path inside the recording")
    if bool(text["x_mm"]) != bool(text["y_mm"]):
        raise BadInputError(place, "x_mm and y_mm must both be given or both be empty")
    position = None
    if text["x_mm"]:
        x_mm = _number(place, "x_mm", text["x_mm"], MAX_POSITION_MM)
        position = x_mm, _number(place, "y_mm", text["y_mm"], MAX_POSITION_MM)
    sequence = _number(place, "sequence", text["sequence"], MAX_SEQUENCE)
    if sequence != int(sequence) or sequence < 0:
        raise BadInputError(place, f"sequence {text['sequence']!r} is not a whole number")
    t_s = _number(place, "t_s", text["t_s"], MAX_T_S)
    leds_on, opaque = text["leds"] == "on", (record.get(OPAQUE) or "").strip()
    return FrameLine(
        number,
        int(sequence),
        t_s,
        text["camera"],
        text["file"],
        leds_on,
        position,
        opaque,
        _stated(place, record, POSE_COLUMNS),
        _stated(place, record, JOINT_COLUMNS),
    )


def _stated(
    place: str, record: Mapping[str, str | None], columns: Mapping[str, float]
) -> tuple[float, ...] | None:
    """Return the numbers of further columns; None if the row does not give them."""
    texts = {column: (record.get(column) or "").strip() for column in columns}
    if not any(texts.values()):
        return None
    if not all(texts.values()):
        raise BadInputError(place, f"{', '.join(columns)} must all be given or all be empty")
    return tuple(_number(place, column, text, columns[column]) for column, text in texts.items())


def _number(place: str, column: str, text: str, limit: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadInputError(place, f"{column} {text!r} is not a number")
    if abs(value) > limit:
        raise BadInputError(place, f"{column} {text!r} is larger than {limit:g}")
    return value
