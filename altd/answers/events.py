"""``altd events``: events of a unit, from its history."""

from __future__ import annotations

import sqlite3
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from altd.errors import BadInputError, did_you_mean
from altd.files.documents import line_of
from altd.files.reading import os_reason
from altd.history.reader import Reader
from altd.history.records import StoredEvent
from altd.history.schema import UnusableFileError
from altd.process.standard_streams import print_lines
from altd.records import utc_text
from altd.status.event_log import SHOWN_KINDS, EventKind
from altd.tables import Column, CsvTable, Type, text


@contextmanager
def opened(path: Path) -> Iterator[Reader]:
    """Open the history in that file; raises BadInputError if it cannot be read."""
    try:
        with Reader(path) as reader:
            yield reader
    except UnusableFileError as error:
        raise BadInputError(path, str(error)) from error
    except sqlite3.Error as error:
        raise BadInputError(path, f"cannot be read: {error}") from error
    except FileNotFoundError as error:
        if error.filename is None or Path(error.filename) != path:
            raise
        raise BadInputError(path, "No such file or directory; the daemon creates it (`[history]`)") from error
    except PermissionError as error:
        if error.filename is None or Path(error.filename) != path:
            raise
        raise BadInputError(path, os_reason(error, path)) from error
    except ValueError as error:  # a NUL in the path
        raise BadInputError(path, "is not a path") from error


_CHECK_INTERVAL_S = 0.5
_MAX_CHECKS = 60
"""Maximum number of checks for a new file: a slow disk takes seconds for each write."""

COLUMNS = (
    Column("id", Type.WHOLE, "", "increases over restarts, unique in a file"),
    Column("time", Type.TIME, "", "UTC"),
    Column("severity", Type.WHOLE, "", "0 good to 4 failure, as the unit's signals"),
    text("kind", "kind of the event"),
    text("of", "the target, component or interface"),
    text("text", "description for people"),
    text("detail", "details, as JSON"),
    Column("held_back", Type.WHOLE, "", "number of similar earlier events that were only counted"),
)
"""Columns of ``--format csv``."""


def answer(
    history: Path, span_us: tuple[int, int], kinds: tuple[str, ...], form: str, *, follow: bool
) -> None:
    """Write the events in the order of their occurrence, no kinds: all; raises BadInputError."""
    for kind in kinds:
        if kind not in set(EventKind):
            possible = ", ".join(EventKind)
            raise BadInputError(
                "--kind", f"{kind[:40]!r}; possible: {possible}{did_you_mean(kind, EventKind)}"
            )
    add = _writer(form)
    while True:
        file = _identity(history)
        last = 0
        with opened(history) as reader:
            while True:
                for event in reader.events_after(last, *span_us, kinds):
                    add(event)
                    last = event.id
                if not follow:
                    return
                sys.stdout.flush()
                time.sleep(_CHECK_INTERVAL_S)
                now = _identity(history)
                if now is not None and now != file:  # moved aside: the daemon has begun another file
                    break
        _wait_until_begun(history)


def _wait_until_begun(file: Path) -> None:
    """Wait until the daemon has made a history of its new file, for a limited time."""
    for _ in range(_MAX_CHECKS):
        time.sleep(_CHECK_INTERVAL_S)
        with suppress(BadInputError), opened(file):
            return


def _identity(file: Path) -> tuple[int, int] | None:
    """(device, inode) of the file; None if it does not exist."""
    try:
        found = file.stat()
    except FileNotFoundError:
        return None
    return found.st_dev, found.st_ino


def event_line(event: StoredEvent) -> str:
    """Text of an event in one line."""
    of = f" {event.of}:" if event.of else ""
    more = f" (and {event.held_back} similar ones before)" if event.held_back else ""
    detail = event.detail.get("detail")
    said = f": {detail}" if isinstance(detail, str) and detail else ""
    kind = SHOWN_KINDS.get(event.kind, event.kind)
    return f"{time_text(event.t_us)} {kind:<11}{of} {event.text}{said}{more}"


def _writer(form: str) -> Callable[[StoredEvent], object]:
    write = sys.stdout.write
    if form == "csv":
        table = CsvTable(write, COLUMNS)
        return lambda event: table.add(
            asdict(event)
            | {"time": time_text(event.t_us), "detail": line_of(event.detail) if event.detail else None}
        )
    if form == "jsonl":
        return lambda event: write(line_of(_document(event)) + "\n")
    return lambda event: print_lines(event_line(event))


def _document(event: StoredEvent) -> dict[str, object]:
    document = asdict(event)
    del document["t_us"], document["epoch"]
    return {"id": document.pop("id"), "time": time_text(event.t_us), **document}


def time_text(t_us: int) -> str:
    """UTC with milliseconds; raises BadInputError for an impossible time."""
    try:
        return utc_text(datetime.fromtimestamp(t_us / 1e6, UTC))
    except (ValueError, OverflowError, OSError) as error:
        raise BadInputError("the history", f"is damaged: a time of {t_us} µs") from error
