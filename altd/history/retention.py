"""Deletion of old parts of the history by age, size and count: a little with each batch, the oldest first.

The oldest part is found by epoch, not by the clock: hours that a wrong clock has put into another year
neither displace later measurements nor stay indefinitely.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from dataclasses import dataclass

from altd.history.schema import HOURS, MINUTES, ROWS_PER_SPAN, SECONDS, SUMMARIES, SummaryTable
from altd.status.event_log import ASKED

MEASUREMENTS_S = 3600
MAX_MEASUREMENTS = 400_000
"""Maximum number of measurements: one hour at 110 per second, less than an hour at higher rates."""

MAX_EVENTS = 100_000
MAX_REQUEST_EVENTS = 10_000
"""Maximum number of events of each kind that any client on the network can cause."""

_ROWS_AT_ONCE = 2000
_EVENTS_AT_ONCE = 1000
_MIN_SECONDS = 3600
"""Number of summaries of 1 s that are kept as long as minutes can be deleted instead."""

_PAGES_AT_ONCE = 512
_RESERVE_BYTES = 12 << 20
"""Space for the write-ahead log and for growth between two batches."""


@dataclass(frozen=True, slots=True)
class Deleted:
    """Number of rows deleted because of size or count, not because of age."""

    what: str
    rows: int


class Retention:
    """Keeps one open file within ``max_bytes``, its write-ahead log included."""

    def __init__(self, connection: sqlite3.Connection, max_bytes: int) -> None:
        self._connection = connection
        self._max_bytes = max_bytes - _RESERVE_BYTES
        sums = ", ".join(f"coalesce(sum({table.name}), 0)" for table in SUMMARIES)
        counts = connection.execute(f"SELECT {sums} FROM epochs").fetchone()  # noqa: S608
        self.rows = {table.name: int(count) for table, count in zip(SUMMARIES, counts, strict=True)}
        self.events = Counter[str](
            dict(connection.execute("SELECT kind, count(*) FROM events GROUP BY kind"))
        )
        """Number of events by kind."""

    def apply(self, epoch: int, epoch_age_s: float, now_us: int) -> list[Deleted]:
        """Delete what is due, in a batch's transaction; returns the deletions not due to age."""
        self._delete_measurements(epoch, epoch_age_s, now_us)
        if SECONDS.max_rows is not None and self.rows[SECONDS.name] > SECONDS.max_rows:
            self._delete_oldest(SECONDS, self.rows[SECONDS.name] - SECONDS.max_rows)
        deleted: list[Deleted] = []
        too_many = [kind for kind in sorted(ASKED) if self.events[kind] > MAX_REQUEST_EVENTS]
        deleted += [
            Deleted(f"{kind} events", self._delete_events("WHERE kind = ?", kind)) for kind in too_many
        ]
        if self.events.total() > MAX_EVENTS:
            deleted.append(Deleted("events", self._delete_events()))
        if self.used_bytes() > self._max_bytes:
            deleted += self._delete_for_room()
        if dropped := self._drop_from_outbox():
            deleted.append(Deleted("summaries of 1 s that no ingest has acknowledged", dropped))
        return deleted

    def shrink(self) -> None:
        """Shrink the file if it exceeds its size limit; call outside a transaction."""
        if self._pragma("page_count") * self._pragma("page_size") > self._max_bytes:
            self._connection.execute(f"PRAGMA incremental_vacuum({_PAGES_AT_ONCE})").fetchall()

    def used_bytes(self) -> int:
        """Return the size of the file without its free pages."""
        pages = self._pragma("page_count") - self._pragma("freelist_count")
        return pages * self._pragma("page_size")

    def _pragma(self, name: str) -> int:
        return int(self._connection.execute(f"PRAGMA {name}").fetchone()[0])

    def _delete_measurements(self, epoch: int, epoch_age_s: float, now_us: int) -> None:
        oldest_us = now_us - MEASUREMENTS_S * 10**6
        (newest,) = self._connection.execute("SELECT max(id) FROM measurements").fetchone()
        last = None
        for number, of_epoch, t_us in self._connection.execute(
            "SELECT id, epoch, t_us FROM measurements ORDER BY id LIMIT ?", (_ROWS_AT_ONCE,)
        ):
            is_old = t_us < oldest_us if of_epoch == epoch else epoch_age_s > MEASUREMENTS_S
            if not is_old and number > newest - MAX_MEASUREMENTS:
                break
            last = number
        if last is not None:
            self._connection.execute("DELETE FROM measurements WHERE id <= ?", (last,))

    def _delete_for_room(self) -> list[Deleted]:
        for table, least in ((SECONDS, _MIN_SECONDS), (MINUTES, 0), (SECONDS, 0), (HOURS, 0)):
            if self.rows[table.name] > least and (rows := self._delete_oldest(table, _ROWS_AT_ONCE)):
                return [Deleted(table.name, rows)]
        return []

    def _delete_oldest(self, table: SummaryTable, rows: int) -> int:
        """Delete up to ``rows`` rows, at most ``_ROWS_AT_ONCE``, of the oldest epoch that has any."""
        found = self._connection.execute(
            "SELECT epoch, CAST(coalesce(first_s, 0) AS INTEGER), CAST(coalesce(last_s, 0) AS INTEGER), "  # noqa: S608
            f"CAST({table.name} AS INTEGER) FROM epochs "
            f"WHERE {table.name} > 0 ORDER BY epoch LIMIT 1"
        ).fetchone()
        if found is None:
            return 0
        epoch, first_s, last_s, there = found
        first_s -= first_s % table.span_s
        gone = self._connection.execute(
            f"DELETE FROM {table.name} WHERE key IN (SELECT key FROM {table.name} "  # noqa: S608
            "WHERE key BETWEEN ? AND ? AND epoch = ? ORDER BY key LIMIT ?)",
            (first_s * ROWS_PER_SPAN, (last_s + 1) * ROWS_PER_SPAN, epoch, min(rows, _ROWS_AT_ONCE)),
        ).rowcount
        counted = gone or there  # the epoch's own count is wrong: set it to 0 so that it is not tried again
        self._connection.execute(
            f"UPDATE epochs SET {table.name} = max({table.name} - ?, 0) WHERE epoch = ?",  # noqa: S608
            (counted, epoch),
        )
        self.rows[table.name] -= counted
        return gone

    def _drop_from_outbox(self) -> int:
        """Delete the oldest entries whose summaries are gone, and count them in the file."""
        dropped = self._connection.execute(
            "DELETE FROM outbox WHERE sequence < (SELECT coalesce((SELECT sequence FROM outbox CROSS JOIN "
            "seconds USING (key) ORDER BY sequence LIMIT 1), (SELECT max(sequence) + 1 FROM outbox)))"
        ).rowcount
        if dropped:
            self._connection.execute(
                "INSERT INTO facts VALUES ('dropped', ?) ON CONFLICT DO UPDATE SET value = value + ?",
                (dropped, dropped),
            )
        return dropped

    def _delete_events(self, where: str = "", *values: str) -> int:
        gone = self._connection.execute(
            f"DELETE FROM events WHERE id IN (SELECT id FROM events {where} ORDER BY severity, id LIMIT ?) "  # noqa: S608
            "RETURNING kind",
            (*values, _EVENTS_AT_ONCE),
        ).fetchall()
        self.events.subtract(kind for (kind,) in gone)
        return len(gone)
