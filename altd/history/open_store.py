"""One open history file: its transactions, its open summaries, and the state of its outbox."""

from __future__ import annotations

import json
import secrets
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

from altd.history.columns import StoredColumn, correlations_of, prepare_columns
from altd.history.facts import Epochs, Reasons, changed_facts
from altd.history.opening import is_damage, touched, transaction
from altd.history.records import (
    About,
    Batch,
    ClockSet,
    Item,
    Notice,
    OutboxMark,
    Sample,
    StateSample,
    Written,
)
from altd.history.retention import Retention
from altd.history.schema import (
    SECONDS,
    SUMMARIES,
    TouchedFileError,
    UnusableFileError,
    column_name,
)
from altd.history.summary import GRACE_S, OpenSpans
from altd.records import Measurement
from altd.status.event_log import Event, EventKind

MAX_LOG_BYTES = 16 << 20
"""Maximum size of the write-ahead log while another program keeps reading; above it, nothing is written."""

_MAX_DELAY_S = 60.0
"""Maximum delay of a measurement's own time behind the clock; otherwise the clock's time is used."""

_US = 10**6

Result = TypeVar("Result")


class OpenStore:
    """One connection and the state of its file."""

    def __init__(
        self, connection: sqlite3.Connection, path: Path, max_bytes: int, about: About, has_outbox: bool
    ) -> None:
        self._connection = connection
        self._path = path
        self._about = about
        self._has_outbox = has_outbox
        self._stream = secrets.token_hex(8)
        self._touched = touched(path)
        self._notices: list[Notice] = []
        self._reported: set[str] = set()
        self.epochs = Epochs(connection)
        self.retention = Retention(connection, max_bytes)
        self._reasons = Reasons(connection)
        self._spans: list[OpenSpans] = []
        self._insert = ""
        self._summarised: list[StoredColumn] = []
        self._summarised_numbers: list[int] = []
        self._delay_s = 0.0
        self._last_us = 0
        self._used_bytes = 0
        self._mark: OutboxMark | None = None
        self._failure: Exception | None = None
        """Failure after the last COMMIT."""
        self.is_committing = False

    def begin(self, batch: Batch, session: str, notices: Sequence[Notice]) -> None:
        """Prepare columns and reasons, and begin an epoch; ``notices`` are written as its first events."""
        first_us = batch.items[0].wall_us if batch.items else batch.wall_us
        with transaction(self._connection):
            (known,) = self._connection.execute(
                "SELECT coalesce((SELECT value FROM facts WHERE name = 'session'), '')"
            ).fetchone()
            is_restart = known != session
            if is_restart and self.epochs.was_interrupted:
                last_s = self.epochs.last_s
                until = "" if last_s is None else f", last heard of at {_text_of(last_s * _US)}"
                self._notices.append(Notice(EventKind.NOT_ENDED, f"the daemon before was not ended{until}"))
            self._notices += [
                *notices,
                *changed_facts(
                    self._connection, {**self._about.facts, "session": session, "stream": self._stream}
                ),
            ]
            self._connection.execute(
                "INSERT OR IGNORE INTO facts VALUES ('file', ?)", (secrets.token_hex(8),)
            )
            self._set_up_columns()
            self.epochs.begin("start" if is_restart else "reopened", first_us, batch.monotonic_ns)
            for notice in self._notices:
                self._add_notice(notice, first_us)
        self._touched = self._tried(lambda: touched(self._path), ())
        self._new_spans()

    def write(self, batch: Batch, name: str) -> None:
        """Write a batch and its name in one transaction."""
        self._check_place()
        with transaction(self._connection):
            if batch.acknowledged is not None and batch.acknowledged[0] == self._stream:
                self._connection.execute("DELETE FROM outbox WHERE sequence <= ?", batch.acknowledged[1:])
            for item in batch.items:
                self._take(item, batch.monotonic_ns)
            self._write_spans()
            for spans in self._spans:
                spans.close(batch.wall_us // _US - GRACE_S - self._delay_s)
            for event in batch.events:
                self._add_event(event)
            self.epochs.save()
            age_s = (batch.monotonic_ns - self.epochs.began_ns) * 1e-9
            for deleted in self.retention.apply(self.epochs.number, age_s, batch.wall_us):
                if deleted.what not in self._reported:
                    self._reported.add(deleted.what)
                    text = f"to free space, the oldest {deleted.what} were deleted"
                    self._notices.append(Notice(EventKind.HISTORY, text, {"rows": deleted.rows}))
                    self._add_notice(self._notices[-1], batch.wall_us)
            self._connection.execute("INSERT OR REPLACE INTO facts VALUES ('batch', ?)", (name,))
            self.is_committing = True
        self.is_committing = False

    def after_commit(self, notices: Sequence[Notice]) -> Written:
        """Shrink the file and describe it. The batch is in the file: a failure is stated, not raised."""
        self._failure = None
        self._tried(self.retention.shrink, None)
        self._used_bytes = self._tried(self.retention.used_bytes, self._used_bytes)
        if self._has_outbox:
            self._mark = self._tried(self._outbox_mark, self._mark)
        self._touched = self._tried(lambda: touched(self._path), ())  # the log may have been checkpointed
        return Written(notices, self._used_bytes, self._mark, _complaint_of(self._failure))

    def _tried(self, step: Callable[[], Result], otherwise: Result) -> Result:
        try:
            return step()
        except Exception as error:
            self._failure = error
            return otherwise

    def last_batch(self) -> str:
        """Return the name of the last batch in the file."""
        row = self._connection.execute("SELECT value FROM facts WHERE name = 'batch'").fetchone()
        return "" if row is None else str(row[0])

    def _outbox_mark(self) -> OutboxMark:
        facts = dict(
            self._connection.execute("SELECT name, value FROM facts WHERE name IN ('file', 'dropped')")
        )
        last, oldest = self._connection.execute(
            "SELECT coalesce((SELECT seq FROM sqlite_sequence WHERE name = 'outbox'), 0), "
            "(SELECT min(sequence) FROM outbox)"
        ).fetchone()
        opened = [spans.first_open for spans in self._spans if spans.first_open is not None]
        complete = min(opened) - 1 if opened else last
        oldest = last + 1 if oldest is None else oldest
        dropped = int(facts.get("dropped", 0))
        return OutboxMark(facts["file"], self._stream, min(oldest, complete + 1), complete, dropped)

    def end(self, wall_us: int) -> None:
        """Mark the epoch as ended."""
        with transaction(self._connection):
            self.epochs.end(wall_us)

    def take_notices(self) -> list[Notice]:
        """Return the notices since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def _log_bytes(self) -> int:
        """Return the size of the write-ahead log in bytes."""
        try:
            return self._path.with_name(f"{self._path.name}-wal").stat().st_size
        except FileNotFoundError:
            return 0

    def close(self) -> None:
        """Close the connection, whatever state the file is in."""
        try:
            self._connection.close()
        except sqlite3.Error:
            return

    def _check_place(self) -> None:
        """Raise if the files are damaged or changed, or if a reader blocks the write-ahead log."""
        if isinstance(self._failure, sqlite3.Error) and is_damage(self._failure):
            raise self._failure
        if not self._touched:
            raise UnusableFileError("could not be examined after the last batch")
        if touched(self._path) != self._touched:
            with suppress(sqlite3.Error):  # a moved file is intact, and its log is written to no other
                self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
            raise TouchedFileError("was replaced, deleted or written by another program while it was open")
        if self._log_bytes() > MAX_LOG_BYTES:
            busy, _, _ = self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
            if busy:
                raise UnusableFileError("another program blocks it with a read that does not end")

    def _set_up_columns(self) -> None:
        numbers = prepare_columns(self._connection, self._about.columns)
        named = zip(self._about.columns, numbers, strict=True)
        names = [column_name(part, number) for column, number in named for part in column.parts]
        fields = ["epoch", "t_us", "sequence", "t_ns", "frames", "valid", "status", *names]
        places = ", ".join("?" * len(fields))
        self._insert = f"INSERT INTO measurements ({', '.join(fields)}) VALUES ({places})"  # noqa: S608
        pairs = [pair for pair in zip(self._about.columns, numbers, strict=True) if pair[0].is_summarised]
        self._summarised = [column for column, _ in pairs]
        self._summarised_numbers = [number for _, number in pairs]

    def _new_spans(self) -> None:
        self._spans = [
            OpenSpans(
                table, self._summarised, self._summarised_numbers, self._has_outbox and table is SECONDS
            )
            for table in SUMMARIES
        ]
        self._delay_s, self._last_us = 0.0, 0

    def _take(self, item: Item, now_ns: int) -> None:
        match item:
            case ClockSet():
                self._write_spans()
                self.epochs.end(None)
                self.epochs.begin("clock", item.wall_us, now_ns)
                self._new_spans()
            case StateSample():
                for spans in self._spans:
                    spans.at(self.epochs.covering(item.wall_us // _US)).note_state(item.fault)
            case Sample():
                self._take_measurement(item)

    def _take_measurement(self, sample: Sample) -> None:
        measurement = sample.measurement
        t_us = sample.wall_us if measurement.time is None else _us_of(measurement.time)
        if not 0 <= sample.wall_us - t_us <= _MAX_DELAY_S * _US:
            t_us = sample.wall_us
        t_us = self._last_us = max(t_us, self._last_us)
        self._delay_s = max(sample.wall_us - t_us, 0) / _US
        self._connection.execute(self._insert, self._row(measurement, t_us))
        for spans in self._spans:
            spans.at(self.epochs.covering(t_us // _US)).add(measurement)

    def _row(self, measurement: Measurement, t_us: int) -> list[object]:
        numbers: list[int | None] = []
        correlations = correlations_of(measurement)
        for column in self._about.columns:
            if column.key in correlations:
                numbers.append(column.steps(correlations[column.key]))
                continue
            known = measurement.known_of(column.key)
            parts = (None, None, None) if known is None else (known.value, known.sigma, known.sigma_random)
            numbers += map(column.steps, parts[: len(column.parts)])
        status = " ".join(map(str, measurement.status)) or None
        about = [self.epochs.number, t_us, measurement.sequence, measurement.t_ns, measurement.frames]
        return [*about, measurement.valid, status, *numbers]

    def _write_spans(self) -> None:
        for spans in self._spans:
            new = spans.write(self._connection, self.epochs.number, self._reasons.number_of)
            self.epochs.count(spans.table.name, new)
            self.retention.rows[spans.table.name] += new

    def _add_event(self, event: Event) -> None:
        about = (event.severity, str(event.kind), event.of, event.text)
        self._insert_event(_us_of(event.time), about, event.detail, event.held_back)

    def _add_notice(self, notice: Notice, t_us: int) -> None:
        about = (notice.kind.severity, str(notice.kind), None, notice.text)
        self._insert_event(t_us, about, notice.detail, 0)

    def _insert_event(
        self, t_us: int, about: tuple[object, ...], detail: Mapping[str, object], held_back: int
    ) -> None:
        text = _detail_text(detail)
        self._connection.execute(
            "INSERT INTO events (epoch, t_us, severity, kind, of, text, detail, held_back) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (self.epochs.number, t_us, *about, text, held_back),
        )
        self.retention.events[str(about[1])] += 1


def _detail_text(detail: Mapping[str, object]) -> str | None:
    """Return the detail as JSON; a detail that JSON cannot represent is dropped, not the whole batch."""
    try:
        return json.dumps(detail, allow_nan=False) if detail else None
    except (ValueError, TypeError, RecursionError):
        return None


def _complaint_of(error: Exception | None) -> str:
    if error is None or isinstance(error, OSError | sqlite3.Error):
        return str(error or "")
    return f"a defect: {type(error).__name__}: {error}"


def _us_of(time: datetime) -> int:
    return round(time.timestamp() * _US)


def _text_of(t_us: int) -> str:
    return datetime.fromtimestamp(t_us / _US, UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
