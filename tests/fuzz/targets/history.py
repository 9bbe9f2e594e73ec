"""Files that might be a history: bytes corrupted on the disk, and rows forged in a good file."""

import math
import sqlite3
from functools import cache
from pathlib import Path
from typing import Any, get_args

from fuzz.folder import folder, one_line
from fuzz.spoil import EXTREME_NUMBERS, EXTREME_TEXTS, spoilt_bytes
from hypothesis import strategies as st
from support.history import START_S, US, batch, event, sample, store, write_seconds

from altd.answers import events, export
from altd.answers.events import opened
from altd.errors import BadInputError
from altd.history.reader import Reader
from altd.history.schema import UnusableFileError

NAME = "history"
_TABLES = ("facts", "epochs", "columns", "reasons", "measurements", "seconds", "minutes", "hours", "events")
_Forgery = tuple[str, int, Any]
"""A table, the number of a column, and what is put into it."""


@cache
def _valid() -> bytes:
    into = folder(NAME) / "valid"
    into.mkdir(exist_ok=True)
    for left in into.iterdir():
        left.unlink()
    writing = store(into)
    write_seconds(writing, START_S, [10.0, None, 11.5], rate=4)
    writing.write(batch(START_S + 6, [sample(START_S + 5)], [event(1, START_S), event(2, START_S + 1)]))
    writing.end(batch(START_S + 7))
    return (into / "history.db").read_bytes()


_NUMBERS = [n for n in EXTREME_NUMBERS if not isinstance(n, int) or -(2**63) <= n < 2**63]
_VALUES = st.one_of(
    st.none(),
    st.sampled_from(_NUMBERS),
    st.sampled_from([text for text in EXTREME_TEXTS if "\ud800" not in text]),
    st.binary(max_size=40),
)
EXAMPLES = st.deferred(
    lambda: (
        spoilt_bytes(st.just(_valid()))
        | st.lists(st.tuples(st.sampled_from(_TABLES), st.integers(0, 30), _VALUES), min_size=1, max_size=3)
    )
)


def check(example: bytes | list[_Forgery]) -> None:
    """Commands end with rows or one line; numbers are finite; the daemon continues, in this or a new file."""
    into = folder(NAME) / "tried"
    into.mkdir(exist_ok=True)
    for left in into.iterdir():
        left.unlink()
    path = into / "history.db"
    path.write_bytes(example if isinstance(example, bytes) else _valid())
    if not isinstance(example, bytes):
        for table, number, value in example:
            _forge(path, table, number, value)
    _export(path, into)
    _ask(path)
    _record(into)


def _forge(path: Path, table: str, number: int, value: object) -> None:
    connection = sqlite3.connect(path)
    names = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
    try:
        with connection:
            connection.execute(f"UPDATE {table} SET {names[number % len(names)]} = ?", (value,))
    except sqlite3.Error:
        return  # SQLite itself does not have it
    finally:
        connection.close()


def _export(path: Path, into: Path) -> None:
    span_us = (0, 2**62)
    for every in get_args(export.Every):
        try:
            export.answer(path, span_us, every, "csv", into / "table.csv")
        except BadInputError as error:
            one_line(error)
    try:
        with opened(path) as reader:
            for one in reader.events_after(0, *span_us):
                assert events.event_line(one)
    except BadInputError as error:
        one_line(error)


def _ask(path: Path) -> None:
    try:
        with Reader(path, timeout_s=2.0) as reader:
            for points in (1, 100):
                for point in reader.trend(START_S * US, (START_S + 60) * US, points).points:
                    for value in point.values.values():
                        numbers = value.mean, value.low, value.high, value.sigma or 0.0
                        assert all(map(math.isfinite, numbers))
            for stored in reader.measurements_after(0, 100):
                assert all(map(math.isfinite, (*stored.values.values(), *stored.sigmas.values())))
            reader.events(0, 2**62)
    except (UnusableFileError, sqlite3.Error, OSError):
        return


def _record(into: Path) -> None:
    writing = store(into)
    for number in range(2):
        try:
            writing.write(batch(START_S + 20 + number, [sample(START_S + 19 + number, sequence=99)]))
        except (UnusableFileError, sqlite3.Error, OSError):
            continue
    writing.end(None)
