"""Running times of earlier daemons, and the share of that time with valid measurements.

The minutes table covers the last day, the hours table the time before, each within the first and last second
of its epoch. If the clock was set while a daemon ran, its epochs follow each other without a gap, whatever
their times are. Each is moved so that it ends where the next one begins; only the clock at the end of a run
is trusted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from altd.history.facts import fault_in
from altd.history.reader import Reader
from altd.history.schema import HOURS, MINUTES, ROWS_PER_SPAN, SummaryTable, UnusableFileError
from altd.reasons import Reason
from altd.status.availability import Before, RunningSpan

MAX_EPOCHS = 1000
"""Maximum number of epochs (starts and clock changes) that are read; earlier time is then unknown."""

_BY_MINUTES_US = 86_400 * 10**6
"""Time before the start that is read from the minutes table."""

_UNKNOWN = "unknown_reason"
_US = 10**6


@dataclass(frozen=True, slots=True)
class _Epoch:
    """An epoch; ``moved_us`` is the correction to add to its clock."""

    number: int
    first_s: int
    last_s: int
    moved_us: int

    @property
    def begin_us(self) -> int:
        return self.first_s * _US + self.moved_us


def before_start(reader: Reader, start_us: int, back_s: float) -> Before:
    """Return the recorded state from ``back_s`` before a start to this start, in UTC of the current clock."""
    from_us = start_us - round(back_s * _US)
    known_us = limit_us = start_us
    spans: list[RunningSpan] = []
    for epoch in _epochs(reader):
        if epoch.begin_us >= limit_us:
            continue  # this daemon's own epoch, or one with a wrong clock
        known_us = epoch.begin_us
        by_minutes_us = max(from_us, start_us - _BY_MINUTES_US)
        spans += _spans(reader, MINUTES, epoch, (by_minutes_us, limit_us), start_us)
        spans += _spans(reader, HOURS, epoch, (from_us, min(by_minutes_us, limit_us)), start_us)
        limit_us = epoch.begin_us
        if limit_us <= from_us:
            break
    return Before((start_us - max(known_us, from_us)) / _US, tuple(spans))


def _epochs(reader: Reader) -> Iterator[_Epoch]:
    """Yield the newest epochs that contain anything, newest first."""
    rows = reader.rows(
        f"SELECT epoch, why, began_us, first_s, last_s FROM epochs ORDER BY epoch DESC LIMIT {MAX_EPOCHS}"  # noqa: S608
    )
    moved_us, next_why, next_us = 0, "start", 0
    for row in rows:
        number, why, began_us, first_s, last_s = row
        if not isinstance(began_us, int) or not isinstance(number, int):
            raise UnusableFileError("is damaged: an epoch without its integers")
        if next_why == "start":
            moved_us = 0
        elif next_why == "clock":
            end_us = began_us if last_s is None else (last_s + 1) * _US
            moved_us += next_us - end_us
        next_why, next_us = why, began_us
        if isinstance(first_s, int) and isinstance(last_s, int):
            yield _Epoch(number, first_s, last_s, moved_us)


def _spans(
    reader: Reader, table: SummaryTable, epoch: _Epoch, between_us: tuple[int, int], start_us: int
) -> Iterator[RunningSpan]:
    """Yield an epoch's rows of a table between two times, newest first."""
    first_us = max(epoch.first_s * _US, between_us[0] - epoch.moved_us)
    end_us = min((epoch.last_s + 1) * _US, between_us[1] - epoch.moved_us)
    if first_us >= end_us:
        return
    first_key = first_us // _US // table.span_s * table.span_s * ROWS_PER_SPAN
    rows = reader.rows(
        f"SELECT key, n, n_valid, worst, lost FROM {table.name} "  # noqa: S608
        "WHERE key >= ? AND key < ? AND epoch = ? ORDER BY key DESC",
        (first_key, -(-end_us // _US) * ROWS_PER_SPAN, epoch.number),
    )
    for row in rows:
        begin_us = row[0] // ROWS_PER_SPAN * _US
        row_end_us = min(begin_us + table.span_s * _US, end_us)
        length_s = (row_end_us - max(begin_us, first_us)) / _US
        if length_s > 0:
            valid, lost_to = _measured(row, reader.codes)
            ended_s = (start_us - epoch.moved_us - row_end_us) / _US
            yield RunningSpan(ended_s, length_s, valid, lost_to)


def _measured(row: Any, codes: dict[int, str]) -> tuple[float, str]:
    """Return the share of a row with valid measurements, and the worst reason for the rest."""
    _, n, n_valid, worst, lost = row
    if not isinstance(n, int) or not isinstance(n_valid, int) or not 0 <= n_valid <= n:
        raise UnusableFileError("is damaged: a summary without its integers")
    code = fault_in(worst if lost is None else lost, codes)[1]
    return n_valid / n if n else 0.0, _without_target(code) or _UNKNOWN


def _without_target(code: str) -> str:
    """Return the code of a reason without its target prefix; any other code unchanged."""
    fitting = (str(reason) for reason in Reason if code == reason or code.endswith(f"_{reason}"))
    return max(fitting, key=len, default=code)
