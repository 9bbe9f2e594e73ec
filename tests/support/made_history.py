"""A history of days as the daemon writes it, except that its rows are inserted at once."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from altd.history.columns import StoredColumn, columns_of
from altd.history.opening import open_to_write
from altd.history.records import About, Batch, StateSample
from altd.history.schema import HOURS, MINUTES, SECONDS, SUMMARY_PARTS, SummaryTable, column_name
from altd.history.store import Store
from altd.instruments.beam.instrument import QUANTITIES

DAY_S = 86_400
_US = 10**6
_SCATTER_STEPS = {"mm": 30.0, "°": 60.0}


def make_history(path: Path, end_s: int, days: int, unit: str) -> None:
    """Write the summaries of these days to a new file; ``end_s`` is a whole hour, Unix time."""
    columns = columns_of(QUANTITIES.with_sensor("roll_deg"), ("front", "rear"))
    store = Store(path, 10**9, About(columns, {"serial": unit}))
    began_us = (end_s - days * DAY_S) * _US
    store.write(Batch(0, began_us, [StateSample(began_us, (0, ""))]))
    store.end(None)
    summarised = [(number, column) for number, column in enumerate(columns) if column.is_summarised]
    names = [column_name(part, number) for number, _ in summarised for part in SUMMARY_PARTS]
    fields = ["key", "epoch", "n", "n_valid", "worst", "lost", *names]
    connection = open_to_write(path)
    for table in (SECONDS, MINUTES, HOURS):
        count = min(days * DAY_S // table.span_s, table.max_rows or sys.maxsize)
        rows = _rows(table, end_s - count * table.span_s, count, [column for _, column in summarised])
        places = ", ".join("?" * len(fields))
        insert = f"INSERT OR REPLACE INTO {table.name} ({', '.join(fields)}) VALUES ({places})"
        connection.execute("BEGIN")
        connection.executemany(insert, rows)
        connection.execute("COMMIT")
    connection.close()


def _rows(
    table: SummaryTable, first_s: int, count: int, columns: Sequence[StoredColumn]
) -> Iterator[list[int | None]]:
    """Rows in which the beam wanders over the whole area; every thousandth second is invalid."""
    random = np.random.default_rng(1)
    parts = []
    for index, column in enumerate(columns):
        scatter = _SCATTER_STEPS[column.unit] * (1 if table is SECONDS else 4)
        phase = 2 * np.pi * (first_s + np.arange(count) * table.span_s) / (5 * DAY_S)
        mean = (50.0 if column.unit == "mm" else 5.0) * np.sin(phase + index) * 10**column.decimals
        mean += random.normal(0, scatter, count)
        below, above = np.rint((random.exponential(1.0, (2, count)) + 1.5) * scatter).astype(int)
        parts += [np.rint(mean).astype(int), random.integers(30, 50, count), below, above]
    for row, numbers in enumerate(np.array(parts).T.tolist()):
        n, t_s = 20 * table.span_s, first_s + row * table.span_s
        lost = 2 * 65536 + 1 if row % 1000 == 0 else None
        yield [t_s * 1000, 1, n, n if lost is None else n // 2, lost, lost, *numbers]
