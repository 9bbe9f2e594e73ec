"""The summaries that are not over yet, and their rows in the file: written with each batch, never merged."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from altd.history.columns import Column
from altd.history.schema import ROWS_PER_SPAN, SUMMARY_PARTS, SummaryTable, column_name
from altd.history.summary import GOOD, Summary, WorstFault

GRACE_S = 3
"""A span accepts measurements for so long after its end, beyond their usual delay."""

FaultNumber = Callable[[WorstFault], int | None]
"""The number in the file for a severity and its code; None: good."""


@dataclass(slots=True)
class _OpenSpan:
    summary: Summary
    key: int | None = None
    is_changed: bool = True


class OpenSpans:
    """The spans of one table that still take measurements. ``numbers`` are those of its columns."""

    def __init__(self, table: SummaryTable, columns: Sequence[Column], numbers: Sequence[int]) -> None:
        self.table = table
        self._columns = columns
        names = [column_name(part, number) for number in numbers for part in SUMMARY_PARTS]
        fields = ["key", "epoch", "n", "n_valid", "worst", "lost", *names]
        places = ", ".join("?" * len(fields))
        self._insert = f"INSERT OR REPLACE INTO {table.name} ({', '.join(fields)}) VALUES ({places})"  # noqa: S608
        self._largest = f"SELECT max(key) FROM {table.name} WHERE key BETWEEN ? AND ?"  # noqa: S608
        self._open: dict[int, _OpenSpan] = {}

    def at(self, t_s: int) -> Summary:
        """The summary of the span that this second lies in; it will be written."""
        begin_s = t_s - t_s % self.table.span_s
        span = self._open.get(begin_s)
        if span is None:
            span = self._open[begin_s] = _OpenSpan(Summary(self._columns))
        span.is_changed = True
        return span.summary

    def write(self, connection: sqlite3.Connection, epoch: int, number_of: FaultNumber) -> int:
        """Write what has changed; returns how many rows are new."""
        new = 0
        for begin_s, span in self._open.items():
            if not span.is_changed:
                continue
            if span.key is None:
                span.key = self._free_key(connection, begin_s)
                new += span.key is not None
            if span.key is not None:
                connection.execute(self._insert, _row(span.key, epoch, span.summary, number_of))
            span.is_changed = False
        return new

    def close(self, until_s: float) -> None:
        """No more is expected for spans that ended before this second; what they hold is written."""
        for begin_s in [begin_s for begin_s in self._open if begin_s + self.table.span_s < until_s]:
            del self._open[begin_s]

    def _free_key(self, connection: sqlite3.Connection, begin_s: int) -> int | None:
        """The first free key of a span; None: a clock has been set to it a thousand times."""
        first = begin_s * ROWS_PER_SPAN
        last = first + ROWS_PER_SPAN - 1
        (largest,) = connection.execute(self._largest, (first, last)).fetchone()
        if largest is None:
            return first
        return int(largest) + 1 if largest < last else None


def _row(key: int, epoch: int, summary: Summary, number_of: FaultNumber) -> list[int | None]:
    worst = None if summary.worst == GOOD else number_of(summary.worst)
    lost = None if summary.lost_to == GOOD else number_of(summary.lost_to)
    return [key, epoch, summary.measurements, summary.valid, worst, lost, *summary.numbers()]
