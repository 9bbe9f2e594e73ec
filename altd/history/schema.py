"""Tables of a history file, version by version, and the checks that a file must pass before it is used.

``seconds``, ``minutes`` and ``hours`` have the same structure. Their ``key`` is the UTC second at which the
span begins, times 1000, plus a number that distinguishes the rows of one span. A span gets a second row after
a restart or after the clock was set back; the first row is kept. ``epoch`` counts starts and clock changes;
within one epoch, time only increases. ``worst`` and ``lost`` are severity · 65536 + the number of a reason.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass

APPLICATION_ID = 0x414C5448
"""``ALTH``, in the header of the file (sqlite.org/fileformat.html, 1.3)."""

SEVERITY_UNIT = 1 << 16
ROWS_PER_SPAN = 1000


@dataclass(frozen=True, slots=True)
class SummaryTable:
    """A table of summaries, the length of their spans, and the row limit; None: limited by file size only."""

    name: str
    span_s: int
    max_rows: int | None


SECONDS = SummaryTable("seconds", 1, 31 * 86_400)
MINUTES = SummaryTable("minutes", 60, None)
HOURS = SummaryTable("hours", 3600, None)
SUMMARIES = (SECONDS, MINUTES, HOURS)

_SUMMARY_SQL = """
CREATE TABLE {name} (
    key INTEGER PRIMARY KEY, epoch INTEGER NOT NULL, n INTEGER NOT NULL, n_valid INTEGER NOT NULL,
    worst INTEGER, lost INTEGER
)"""

_VERSION_1 = (
    "CREATE TABLE facts (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID",
    """
CREATE TABLE epochs (
    epoch INTEGER PRIMARY KEY, why TEXT NOT NULL, began_us INTEGER NOT NULL, ended_us INTEGER,
    first_s INTEGER, last_s INTEGER,
    seconds INTEGER NOT NULL DEFAULT 0, minutes INTEGER NOT NULL DEFAULT 0, hours INTEGER NOT NULL DEFAULT 0
)""",
    """
CREATE TABLE columns (
    number INTEGER PRIMARY KEY, key TEXT NOT NULL, unit TEXT NOT NULL, decimals INTEGER NOT NULL,
    label TEXT NOT NULL, is_summarised INTEGER NOT NULL, is_from_sensor INTEGER NOT NULL
)""",
    "CREATE TABLE reasons (number INTEGER PRIMARY KEY, code TEXT NOT NULL UNIQUE)",
    """
CREATE TABLE measurements (
    id INTEGER PRIMARY KEY AUTOINCREMENT, epoch INTEGER NOT NULL, t_us INTEGER NOT NULL,
    sequence INTEGER NOT NULL, t_ns INTEGER NOT NULL, frames INTEGER NOT NULL, valid INTEGER NOT NULL,
    status TEXT
)""",
    *(_SUMMARY_SQL.format(name=table.name) for table in SUMMARIES),
    """
CREATE TABLE events (
    id INTEGER PRIMARY KEY AUTOINCREMENT, epoch INTEGER NOT NULL, t_us INTEGER NOT NULL,
    severity INTEGER NOT NULL, kind TEXT NOT NULL, of TEXT, text TEXT NOT NULL, detail TEXT,
    held_back INTEGER NOT NULL
)""",
    "CREATE INDEX events_by_severity ON events (severity, id)",
)

_VERSION_2 = ("CREATE INDEX events_by_time ON events (t_us)",)
"""Index by time, so that the events of a day are found without reading those of years."""

_VERSION_3 = ("SELECT number FROM columns",)
"""Measurements also store the random part of sigma: a column ``random_N`` for each quantity N."""

_VERSION_4 = ("CREATE TABLE outbox (sequence INTEGER PRIMARY KEY AUTOINCREMENT, key INTEGER NOT NULL)",)
"""Summaries of 1 s that no ingest has acknowledged yet; a sequence is never reused in one file."""

MIGRATIONS: Sequence[Sequence[str]] = (_VERSION_1, _VERSION_2, _VERSION_3, _VERSION_4)
"""Statements that migrate version n to version n + 1; an empty file has version 0.

A SELECT returns the numbers of the quantities that get a new column.
"""

VERSION = len(MIGRATIONS)

_TABLES = {
    *("facts", "epochs", "columns", "reasons", "measurements", "events", "outbox"),
    *(t.name for t in SUMMARIES),
}
_OTHERS = {"sqlite_sequence", "sqlite_autoindex_reasons_1", "events_by_severity", "events_by_time"}
MAX_COLUMNS = 128
MEASUREMENT_PARTS = ("value", "sigma", "random")
SUMMARY_PARTS = ("mean", "sigma", "below", "above")


class UnusableFileError(Exception):
    """The file is not a history that this program reads; the message states what it is instead."""


class DamagedFileError(UnusableFileError):
    """The file was or may have been a history and can no longer be read."""


class TouchedFileError(UnusableFileError):
    """Another program replaced, deleted or wrote the history while it was open."""


class MovedFileError(UnusableFileError):
    """A history that is damaged or of another unit was moved aside."""


class NewerFileError(UnusableFileError):
    """The history was written by a newer program."""


class ForeignFileError(UnusableFileError):
    """The history belongs to another unit."""


def column_name(part: str, number: int) -> str:
    """Return the name of a quantity's column, such as ``mean_3``."""
    return f"{part}_{number}"


def version_of(connection: sqlite3.Connection) -> int:
    """Return the version of an open file, 0 if it is empty; raises UnusableFileError."""
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (objects,) = connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    if not objects and not application and not version:
        return 0
    if application != APPLICATION_ID:
        raise UnusableFileError("is a database, but no history of altd")
    if version > VERSION:
        raise NewerFileError(
            f"is of version {version}, and this program knows {VERSION}: it was left as it is"
        )
    if version < 1:
        raise DamagedFileError(f"has version {version}, which there never was")
    return int(version)


def migrate(connection: sqlite3.Connection, version: int) -> None:
    """Migrate a file of this version to the newest, each step in its own transaction."""
    for number, statements in enumerate(MIGRATIONS[version:], version + 1):
        connection.execute("BEGIN IMMEDIATE")
        try:
            for statement in statements:
                for (quantity,) in connection.execute(statement).fetchall():
                    name = column_name("random", quantity)
                    connection.execute(f"ALTER TABLE measurements ADD COLUMN {name} INTEGER")
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {number}")
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise


def check_tables(connection: sqlite3.Connection) -> None:
    """Raise DamagedFileError if a file of the newest version does not have this module's tables.

    Reading a view, a virtual table or a generated column would execute SQL written by the file's author.
    """
    found = dict(
        connection.execute("SELECT name, type || iif(rootpage > 0, '', ' without pages') FROM sqlite_schema")
    )
    for name, kind in found.items():
        if kind != ("table" if name in _TABLES or name == "sqlite_sequence" else "index"):
            raise DamagedFileError(f"has {kind} {str(name)[:40]!r}")
    if set(found) - _OTHERS != _TABLES:
        strange = ", ".join(sorted(map(str, (set(found) - _OTHERS) ^ _TABLES))[:5])
        raise DamagedFileError(f"has other tables than a history: {strange[:200]}")
    for table in _TABLES:
        for row in connection.execute(f"PRAGMA table_xinfo({table})"):
            if row[6] != 0:
                raise DamagedFileError(f"has a hidden column in {table}")
