"""Measurements of a second, a minute or an hour as one row.

Spans that are still open are written with each batch, and never merged.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from altd.history.columns import StoredColumn
from altd.history.schema import ROWS_PER_SPAN, SUMMARY_PARTS, SummaryTable, column_name
from altd.reasons import Signal
from altd.records import Measurement
from altd.status.cause import signal_of
from altd.status.causes import is_warning

WorstFault = tuple[int, str]
"""A severity (0 good to 4 failure) and the code of its reason; the larger tuple is the worse."""

GOOD: WorstFault = (Signal.GOOD.severity, "")

GRACE_S = 3
"""Time after its end during which a span still accepts measurements, beyond their usual delay, s."""

FaultNumber = Callable[[WorstFault], int | None]
"""Maps a severity and its code to the number in the file; None: good."""


@dataclass(slots=True)
class _Sums:
    """Sums of one quantity over the measurements that contain it."""

    count: int = 0
    total: float = 0.0
    variance_total: float = 0.0
    sigmas: int = 0
    low: float = math.inf
    high: float = -math.inf

    def add(self, value: float, sigma: float | None) -> None:
        self.count += 1
        self.total += value
        self.low, self.high = min(self.low, value), max(self.high, value)
        if sigma is not None:
            self.sigmas += 1
            self.variance_total += sigma * sigma

    def row(self, column: StoredColumn) -> tuple[int | None, ...]:
        """Return mean, sigma, mean − lowest, highest − mean, in steps."""
        low, high = column.steps(self.low), column.steps(self.high)
        if not self.count or low is None or high is None:
            return None, None, None, None
        mean = min(max(round(self.total / self.count * 10**column.decimals), low), high)
        sigma = math.sqrt(self.variance_total / self.sigmas) if self.sigmas else None
        return mean, column.steps(sigma), mean - low, high - mean


@dataclass(slots=True)
class Summary:
    """Measurements in a span of time, and the worst fault in it.

    The mean is that of the valid measurements. Sigma is the root of the mean of their variances: the
    uncertainty of one measurement, not their scatter. ``worst`` is the worst state of the unit, ``lost_to``
    the worst reason of the invalid measurements.
    """

    columns: Sequence[StoredColumn]
    measurements: int = 0
    valid: int = 0
    worst: WorstFault = GOOD
    lost_to: WorstFault = GOOD
    _sums: list[_Sums] = field(init=False)

    def __post_init__(self) -> None:
        self._sums = [_Sums() for _ in self.columns]

    def add(self, measurement: Measurement) -> None:
        """Add a measurement, valid or not."""
        self.measurements += 1
        if measurement.valid:
            self.valid += 1
        else:
            self.lost_to = max(self.lost_to, worst_fault_of(measurement))
        for column, sums in zip(self.columns, self._sums, strict=True):
            known = measurement.known_of(column.key)
            if known is not None and math.isfinite(known.value):
                sums.add(known.value, known.sigma)

    def note_state(self, fault: WorstFault) -> None:
        """Add the state that the unit had in this time."""
        self.worst = max(self.worst, fault)

    def numbers(self) -> list[int | None]:
        """Return mean, sigma, mean − lowest and highest − mean of each column, in steps."""
        return [
            number
            for column, sums in zip(self.columns, self._sums, strict=True)
            for number in sums.row(column)
        ]


def worst_fault_of(measurement: Measurement) -> WorstFault:
    """Return the worst of the reasons for which a measurement is invalid."""
    reasons = [fault for fault in measurement.status if not is_warning(fault)]
    return max(
        ((signal_of(fault.reason).severity, str(fault)) for fault in reasons), default=(4, "unknown_reason")
    )


@dataclass(slots=True)
class _OpenSpan:
    summary: Summary
    key: int | None = None
    is_changed: bool = True
    sequence: int | None = None
    """Sequence in the outbox; None: not queued."""


class OpenSpans:
    """Spans of one table that still accept measurements. ``numbers`` are those of its columns.

    ``is_queued``: its rows are also put into the outbox.
    """

    def __init__(
        self, table: SummaryTable, columns: Sequence[StoredColumn], numbers: Sequence[int], is_queued: bool
    ) -> None:
        self.table = table
        self._is_queued = is_queued
        self._columns = columns
        names = [column_name(part, number) for number in numbers for part in SUMMARY_PARTS]
        fields = ["key", "epoch", "n", "n_valid", "worst", "lost", *names]
        places = ", ".join("?" * len(fields))
        self._insert = f"INSERT OR REPLACE INTO {table.name} ({', '.join(fields)}) VALUES ({places})"  # noqa: S608
        self._largest = f"SELECT max(key) FROM {table.name} WHERE key BETWEEN ? AND ?"  # noqa: S608
        self._open: dict[int, _OpenSpan] = {}

    def at(self, t_s: int) -> Summary:
        """Return the summary of the span that contains this second, and mark it as changed."""
        begin_s = t_s - t_s % self.table.span_s
        span = self._open.get(begin_s)
        if span is None:
            span = self._open[begin_s] = _OpenSpan(Summary(self._columns))
        span.is_changed = True
        return span.summary

    def write(self, connection: sqlite3.Connection, epoch: int, number_of: FaultNumber) -> int:
        """Write the changed spans; returns the number of new rows."""
        new = 0
        for begin_s, span in self._open.items():
            if not span.is_changed:
                continue
            if span.key is None:
                span.key = self._free_key(connection, begin_s)
                new += span.key is not None
                if self._is_queued and span.key is not None:
                    queue = "INSERT INTO outbox (key) VALUES (?)"
                    span.sequence = connection.execute(queue, (span.key,)).lastrowid
            if span.key is not None:
                connection.execute(self._insert, _row(span.key, epoch, span.summary, number_of))
            span.is_changed = False
        return new

    def close(self, until_s: float) -> None:
        """Close the spans that ended before this second; call after their last ``write``."""
        for begin_s in [begin_s for begin_s in self._open if begin_s + self.table.span_s < until_s]:
            del self._open[begin_s]

    @property
    def first_open(self) -> int | None:
        """Lowest sequence in the outbox whose row may still change; None: there is none."""
        return min((span.sequence for span in self._open.values() if span.sequence is not None), default=None)

    def _free_key(self, connection: sqlite3.Connection, begin_s: int) -> int | None:
        """Return the first free key of a span; None: all 1000 keys of the span are in use."""
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
