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
from altd.history.schema import SECONDS, UnusableFileError
from altd.process.standard_streams import print_errors, print_lines
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
_RECORDED_US = 59 * 10**6  # less than a minute: of the table of seconds
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
    """Write the events in the order of their occurrence, no kinds: all; raises BadInputError.

    As text, what was in force when the span began comes first.
    """
    codes = {word: code for code, word in SHOWN_KINDS.items()}
    kinds = tuple(codes.get(kind, kind) for kind in kinds)
    for kind in kinds:
        if kind not in set(EventKind):
            possible = ", ".join(EventKind)
            raise BadInputError(
                "--kind", f"{kind[:40]!r}; possible: {possible}{did_you_mean(kind, EventKind)}"
            )
    add = _writer(form)
    is_first = True
    while True:
        file = _identity(history)
        last = 0
        with opened(history) as reader:
            is_first = is_first and not _introduce(reader, span_us, form)
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


def _introduce(reader: Reader, span_us: tuple[int, int], form: str) -> bool:
    """Say what was in force when the span began, and whether the history goes back so far."""
    from_us, to_us = span_us
    oldest = next(reader.events_after(0, 0, 2**62), None)
    if oldest is None or oldest.t_us >= to_us:
        begun = "is empty" if oldest is None else f"begins at {time_text(oldest.t_us)}"
        print_errors(f"altd events: the history {begun}: nothing is known of this time")
    elif from_us > oldest.t_us and form == "text":
        print_lines(f"at {time_text(from_us)} in force, since:", *map(event_line, in_force(reader, from_us)))
        is_kept = next(reader.summaries(SECONDS, 0, from_us - _RECORDED_US), None) is not None
        if is_kept and not reader.trend(from_us - _RECORDED_US, from_us, 1, []).points:
            print_lines("but nothing was measured in the minute before: the unit was off or did not run")
        print_lines("then:")
    return True


def in_force(reader: Reader, t_us: int) -> list[StoredEvent]:
    """Return the events that describe the unit at this time: start or end, state, and causes not ended."""
    found: list[StoredEvent] = []
    ended = set[tuple[str | None, object]]()
    for event in reader.events(0, t_us):
        key = event.of, event.detail.get("code", event.text)
        if event.kind == EventKind.CAUSE_CAME and key not in ended:
            found.append(event)
        if event.kind in (EventKind.CAUSE_CAME, EventKind.CAUSE_WENT):
            ended.add(key)
        if event.kind == EventKind.STATE and not any(known.kind == EventKind.STATE for known in found):
            found.append(event)
        if event.kind in (EventKind.STARTED, EventKind.STOPPED):
            found.append(event)
            break
    return found[::-1]


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
