"""Reading a history: rows in the order of time, points of a trend, measurements after an id, events.

Every query is limited in rows, and in time if a timeout is given. The file is not held between two queries:
one query at most delays the transfer of the daemon's write-ahead log into the file.
"""

from __future__ import annotations

import json
import math
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from altd.history.columns import StoredColumn, columns_in
from altd.history.facts import check_unit, codes_in, fault_in
from altd.history.opening import open_to_read, typed_damage
from altd.history.records import (
    QueuedSecond,
    StoredEvent,
    StoredMeasurement,
    SummaryPoint,
    SummaryValue,
    Trend,
)
from altd.history.schema import (
    HOURS,
    MEASUREMENT_PARTS,
    MINUTES,
    ROWS_PER_SPAN,
    SECONDS,
    SUMMARY_PARTS,
    SummaryTable,
    UnusableFileError,
    column_name,
)

MAX_POINTS = 5000
MAX_ROWS = 5000
"""Maximum number of rows of one query."""

_US = 10**6
_EVENT_FIELDS = "id, epoch, t_us, severity, kind, of, text, detail, held_back"
_STEPS_BETWEEN_CHECKS = 20_000
"""Steps of SQLite's virtual machine, about 0.2 ms, between two checks of the clock."""


class HistoryTimeoutError(Exception):
    """A query exceeded its time limit."""


class Reader:
    """An open history file."""

    def __init__(self, path: Path, timeout_s: float | None = None) -> None:
        """Open; each query may take ``timeout_s``. Raises UnusableFileError, OSError and sqlite3.Error."""
        self._timeout_s = timeout_s
        self._deadline = math.inf
        self._connection = open_to_read(path)
        if timeout_s is not None:
            self._start_clock()
            self._connection.set_progress_handler(self._is_late, _STEPS_BETWEEN_CHECKS)
        try:
            with typed_damage():
                self._columns = columns_in(self._connection)
                self.codes = codes_in(self._connection)
                """Codes of reasons and causes by their numbers in the file."""
        except BaseException:
            self._connection.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    @property
    def summarised(self) -> dict[str, StoredColumn]:
        """Quantities in summaries, by key."""
        return {column.key: column for column in self._columns.values() if column.is_summarised}

    @property
    def recorded(self) -> dict[str, StoredColumn]:
        """Quantities in measurements, by key; those of a target as ``TARGET.KEY``."""
        return {column.key: column for column in self._columns.values()}

    def facts(self) -> dict[str, str]:
        """Return the newest daemon's facts: ``serial``, ``version``, ``config``, ``calibration``."""
        return {str(name): str(value) for name, value in self.rows("SELECT name, value FROM facts LIMIT 100")}

    def check_unit(self, serial: str) -> None:
        """Raise ForeignFileError for a history of another unit."""
        check_unit(self._connection, {"serial": serial})

    def trend(self, from_us: int, to_us: int, max_points: int, keys: Sequence[str] | None = None) -> Trend:
        """Return the trend from ``from_us`` to before ``to_us`` in at most ``max_points``; None: all keys.

        Reads the coarsest table with at least one row per point: at most 60 rows per point, of hours any
        number. Raises ValueError for an invalid time, count or key.
        """
        if not 0 <= from_us < to_us < 2**62 or not 1 <= max_points <= MAX_POINTS:
            raise ValueError(f"a trend is of a span of time, in 1 to {MAX_POINTS} points")
        columns = self._chosen(keys)
        span_s = (to_us - from_us) / _US
        table = next((t for t in (HOURS, MINUTES) if span_s / t.span_s >= max_points), SECONDS)
        first_s, last_s = from_us // _US, -(-to_us // _US)
        first_s -= first_s % table.span_s
        rows_a_point = max(math.ceil((last_s - first_s) / (table.span_s * max_points)), 1)
        width_s = table.span_s * rows_a_point
        sums = [part for number, column in columns for part in _grouped(number, column)]
        sql = (
            f"SELECT (key / {ROWS_PER_SPAN} - ?) / ? AS point, sum(n), sum(n_valid), max(worst), max(lost)"  # noqa: S608
            f"{''.join(f', {part}' for part in sums)} FROM {table.name} "
            "WHERE key >= ? AND key < ? GROUP BY point ORDER BY point LIMIT ?"
        )
        bounds = (first_s, width_s, first_s * ROWS_PER_SPAN, last_s * ROWS_PER_SPAN, max_points)
        points = [self._point(row, first_s, width_s, columns) for row in self.rows(sql, bounds)]
        return Trend(table.name, width_s * _US, tuple(points))

    def summaries(self, table: SummaryTable, from_us: int, to_us: int) -> Iterator[SummaryPoint]:
        """Yield a table's rows that begin in this time; one query reads at most ``MAX_ROWS`` of them."""
        columns = self._chosen(None)
        names = [column_name(part, number) for number, _ in columns for part in SUMMARY_PARTS]
        sql = (
            f"SELECT key, n, n_valid, worst, lost{''.join(f', {name}' for name in names)}, epoch "  # noqa: S608
            f"FROM {table.name} WHERE key >= ? AND key < ? ORDER BY key LIMIT {MAX_ROWS}"
        )
        first = -(-max(from_us, 0) // _US) * ROWS_PER_SPAN
        while rows := self.rows(sql, (first, -(-min(to_us, 2**52) // _US) * ROWS_PER_SPAN)):
            for row in rows:
                (epoch,) = _whole(row[-1:], table.name)
                yield replace(self._summary(row[:-1], table, columns), epoch=epoch)
            first = _further(rows[-1][0], first - 1) + 1

    def queued(self, stream: str, after: int, last: int, limit: int) -> list[QueuedSecond]:
        """Return the summaries in the outbox with ``after`` < sequence ≤ ``last``, oldest first.

        Raises UnusableFileError if the file in this place has another stream than ``stream``.
        """
        if self.facts().get("stream") != stream:
            raise UnusableFileError("was opened again")
        columns = self._chosen(None)
        names = [column_name(part, number) for number, _ in columns for part in SUMMARY_PARTS]
        sql = (
            f"SELECT sequence, epoch, key, n, n_valid, worst, lost{''.join(f', {name}' for name in names)} "  # noqa: S608
            "FROM outbox CROSS JOIN seconds USING (key) WHERE sequence > ? AND sequence <= ? "
            "ORDER BY sequence LIMIT ?"
        )
        rows = self.rows(sql, (after, last, min(limit, MAX_ROWS)))
        found = []
        for row in rows:
            number, epoch = _whole(row[:2], "outbox")
            found.append(QueuedSecond(number, epoch, self._summary(row[2:], SECONDS, columns)))
        return found

    def measurements_after(self, after: int, limit: int) -> list[StoredMeasurement]:
        """Return the measurements with a larger id, oldest first. Raises ValueError for an invalid limit."""
        if not 0 <= after < 2**62 or not 1 <= limit <= MAX_ROWS:
            raise ValueError(f"measurements are asked for after an id, 1 to {MAX_ROWS} at once")
        return self._measurements("id > ? ORDER BY id LIMIT ?", (after, limit))

    def measurements_between(
        self, first: int, last: int, limit: int, *, newest_first: bool = False
    ) -> list[StoredMeasurement]:
        """Return the measurements with an id from ``first`` to ``last``, in its order."""
        order = "DESC" if newest_first else "ASC"
        return self._measurements(f"id >= ? AND id <= ? ORDER BY id {order} LIMIT ?", (first, last, limit))

    def id_of(self, sequence: int, t_ns: int) -> int | None:
        """Return the id of the newest measurement with this sequence and monotonic time; None: none."""
        sql = "SELECT max(id) FROM measurements WHERE sequence = ? AND t_ns = ?"
        ((number,),) = self.rows(sql, (sequence, t_ns))
        return number if isinstance(number, int) else None

    def measurements(self, from_us: int, to_us: int) -> Iterator[StoredMeasurement]:
        """Yield the measurements of this time in the order in which they were made."""
        after, span = 0, (max(from_us, 0), min(to_us, 2**62))
        where = "id > ? AND t_us >= ? AND t_us < ? ORDER BY id LIMIT ?"
        while rows := self._measurements(where, (after, *span, MAX_ROWS)):
            yield from rows
            after = _further(rows[-1].id, after)

    def events(
        self,
        from_us: int,
        to_us: int,
        kinds: Sequence[str] = (),
        limit: int = MAX_ROWS,
        before: int | None = None,
    ) -> list[StoredEvent]:
        """Return the newest events of this time, newest first; ``before``: only events with a smaller id.

        Without kinds, events of all kinds. Raises ValueError for an invalid limit.
        """
        if not 1 <= limit <= MAX_ROWS or len(kinds) > 100:
            raise ValueError(f"1 to {MAX_ROWS} events are asked for at once")
        of_kinds = f"AND kind IN ({', '.join('?' * len(kinds))}) " if kinds else ""
        sql = (
            f"SELECT {_EVENT_FIELDS} FROM events "  # noqa: S608
            f"WHERE id < ? AND t_us >= ? AND t_us < ? {of_kinds}ORDER BY id DESC LIMIT ?"
        )
        first = 2**62 if before is None else max(min(before, 2**62), 0)
        bounds = (first, max(from_us, 0), min(to_us, 2**62), *kinds, limit)
        return [_event(row) for row in self.rows(sql, bounds)]

    def events_after(
        self, after: int, from_us: int, to_us: int, kinds: Sequence[str] = ()
    ) -> Iterator[StoredEvent]:
        """Yield the events of this time with a larger id, in the order in which they were recorded."""
        of_kinds = f"AND kind IN ({', '.join('?' * len(kinds))}) " if kinds else ""
        sql = (
            f"SELECT {_EVENT_FIELDS} FROM events "  # noqa: S608
            f"WHERE id > ? AND t_us >= ? AND t_us < ? {of_kinds}ORDER BY id LIMIT {MAX_ROWS}"
        )
        span = (max(from_us, 0), min(to_us, 2**62))
        while rows := self.rows(sql, (after, *span, *kinds)):
            yield from (_event(row) for row in rows)
            after = _further(rows[-1][0], after)

    def _measurements(self, where: str, values: Sequence[object]) -> list[StoredMeasurement]:
        names = [column_name(part, number) for number, each in self._columns.items() for part in each.parts]
        fields = ["id", "epoch", "t_us", "sequence", "t_ns", "frames", "valid", "status", *names]
        sql = f"SELECT {', '.join(fields)} FROM measurements WHERE {where}"  # noqa: S608
        return [self._measurement(row) for row in self.rows(sql, values)]

    def _measurement(self, row: Sequence[Any]) -> StoredMeasurement:
        number, epoch, t_us, sequence, t_ns, frames, valid = _whole(row[:7], "measurements")
        status = tuple(row[7].split()) if isinstance(row[7], str) else ()
        of_part: dict[str, dict[str, float]] = {part: {} for part in MEASUREMENT_PARTS}
        places = ((column, part) for column in self._columns.values() for part in column.parts)
        for (column, part), known in zip(places, row[8:], strict=True):
            if known is not None:
                of_part[part][column.key] = _number(column, known)
        parts = of_part.values()
        return StoredMeasurement(number, epoch, t_us, sequence, t_ns, frames, bool(valid), status, *parts)

    def _summary(
        self, row: Sequence[Any], table: SummaryTable, columns: Sequence[tuple[int, StoredColumn]]
    ) -> SummaryPoint:
        key, n, n_valid = _whole(row[:3], table.name)
        values = {}
        for (_, column), place in zip(columns, range(5, len(row), 4), strict=True):
            mean, sigma, below, above = row[place : place + 4]
            if mean is None:
                continue
            mean, below, above = _whole((mean, below, above), table.name)
            low, high = _number(column, mean - below), _number(column, mean + above)
            known_sigma = None if sigma is None else _number(column, sigma)
            values[column.key] = SummaryValue(_number(column, mean), known_sigma, low, high)
        t_us, span_us = key // ROWS_PER_SPAN * _US, table.span_s * _US
        return SummaryPoint(t_us, span_us, n, n_valid, *self._faults(row[3], row[4]), values)

    def _point(
        self, row: Sequence[Any], first_s: int, width_s: int, columns: Sequence[tuple[int, StoredColumn]]
    ) -> SummaryPoint:
        point, n, n_valid = _whole(row[:3], "summaries")
        values = {}
        for (_, column), place in zip(columns, range(5, len(row), 6), strict=True):
            total, weight, variances, of_sigma, low, high = row[place : place + 6]
            if not weight or low is None or high is None:
                continue
            sigma = None if not of_sigma else _number(column, math.sqrt(variances / of_sigma))
            mean = min(max(total / weight, low), high)
            values[column.key] = SummaryValue(
                _number(column, mean), sigma, _number(column, low), _number(column, high)
            )
        t_us = (first_s + point * width_s) * _US
        return SummaryPoint(t_us, width_s * _US, n, n_valid, *self._faults(row[3], row[4]), values)

    def _faults(self, worst: object, lost: object) -> tuple[int, str, str]:
        severity, code = fault_in(worst, self.codes)
        return severity, code, fault_in(lost, self.codes)[1]

    def _chosen(self, keys: Sequence[str] | None) -> list[tuple[int, StoredColumn]]:
        by_key = {
            column.key: (number, column) for number, column in self._columns.items() if column.is_summarised
        }
        for key in keys or ():
            if key not in by_key:
                raise ValueError(f"there is no quantity {key[:40]!r}; possible: {', '.join(by_key)}")
        return list(by_key.values()) if keys is None else [by_key[key] for key in dict.fromkeys(keys)]

    def rows(self, sql: str, values: Sequence[object] = ()) -> list[Any]:
        """Return the rows of a query within its time; raises HistoryTimeoutError and UnusableFileError."""
        self._start_clock()
        try:
            with typed_damage():
                return self._connection.execute(sql, values).fetchall()
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode == sqlite3.SQLITE_INTERRUPT:
                raise HistoryTimeoutError(f"it took more than {self._timeout_s:g} s") from error
            raise

    def _start_clock(self) -> None:
        if self._timeout_s is not None:
            self._deadline = time.monotonic() + self._timeout_s

    def _is_late(self) -> bool:
        return time.monotonic() > self._deadline


def _grouped(number: int, column: StoredColumn) -> list[str]:
    """Return a column's aggregates in SQL: total, weight, variances, their weight, lowest, highest.

    A sensor's value is known whether or not the beam is visible, so all measurements count for it.
    """
    mean, sigma, below, above = (column_name(part, number) for part in SUMMARY_PARTS)
    weight = "n" if column.is_from_sensor else "n_valid"
    return [
        f"sum({mean} * {weight})",
        f"sum(iif({mean} IS NULL, 0, {weight}))",
        f"sum({sigma} * {sigma} * {weight})",
        f"sum(iif({sigma} IS NULL, 0, {weight}))",
        f"min({mean} - {below})",
        f"max({mean} + {above})",
    ]


def _further(last: int, before: int) -> int:
    """Return the last row's number; raise if it did not increase, which a damaged file can cause."""
    if last <= before:
        raise UnusableFileError("is damaged: its rows are not in their order")
    return last


def _whole(values: Sequence[Any], table: str) -> list[int]:
    if not all(isinstance(value, int) for value in values):
        raise UnusableFileError(f"is damaged: a row of {table} without its integers")
    return list(values)


def _number(column: StoredColumn, steps: object) -> float:
    value = column.value(steps) if isinstance(steps, int | float) else None
    if value is None or not math.isfinite(value):
        raise UnusableFileError(f"is damaged: {column.key[:40]} is not a number")
    return value


def _event(row: Sequence[Any]) -> StoredEvent:
    number, epoch, t_us, severity = _whole(row[:4], "events")
    kind, of, text, detail, held_back = row[4:]
    return StoredEvent(
        number,
        epoch,
        t_us,
        severity,
        str(kind),
        None if of is None else str(of),
        str(text),
        _detail(detail),
        held_back if isinstance(held_back, int) else 0,
    )


def _detail(text: object) -> Mapping[str, object]:
    try:
        document = json.loads(text) if isinstance(text, str) else {}
    except (ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}
