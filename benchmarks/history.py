"""A generated year of history: its size, and the time to read its trends. ``python -m benchmarks.history``.

A unit with an inclinometer that ran for a year: 31 days of summaries of 1 s, 525,600 of 1 min, 8,760 of 1 h,
an hour of measurements, 100,000 events. The values scatter as those of a unit; every thousandth second is
invalid. The file is a history as the daemon writes it, except that the rows are inserted at once.
"""

import sqlite3
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from altd.history.columns import Column, columns_of
from altd.history.opening import open_to_write
from altd.history.reader import Reader
from altd.history.records import About, Batch, StateSample
from altd.history.schema import HOURS, MINUTES, SECONDS, SUMMARY_PARTS, SummaryTable, column_name
from altd.history.store import Store
from altd.instruments.beam.instrument import QUANTITIES
from benchmarks.harness import Parser, end

END_S = 1_795_161_600
"""End of the history, 2026-11-20T08:00:00Z, at a whole hour."""

DAY_S = 86_400
SPANS = {
    "20 min": 1200,
    "12 h": 43_200,
    "1 day": DAY_S,
    "7 days": 7 * DAY_S,
    "31 days": 31 * DAY_S,
    "1 year": 365 * DAY_S,
}
_US = 10**6
_AT_ONCE = 50_000
_SCATTER_STEPS = {"mm": 30.0, "°": 60.0}
_REPEATS = 5


def make_history(path: Path, end_s: int = END_S, days: int = 365, unit: str = "BENCH") -> None:
    """Write this number of days of history to a new file; ``end_s`` is a whole hour, Unix time."""
    columns = columns_of(QUANTITIES.with_sensor("roll_deg"), ("front", "rear"))
    store = Store(path, 10**9, About(columns, {"serial": unit}))
    began_us = (end_s - days * DAY_S) * _US
    store.write(Batch(0, began_us, [StateSample(began_us, (0, ""))]))
    store.end(None)
    random = np.random.default_rng(1)
    summarised = [(number, column) for number, column in enumerate(columns) if column.is_summarised]
    connection = open_to_write(path)
    for table in (SECONDS, MINUTES, HOURS):
        rows = min(days * DAY_S // table.span_s, table.max_rows or sys.maxsize)
        _fill(connection, table, rows, summarised, random, end_s)
    _fill_measurements(connection, columns, random, end_s)
    _fill_events(connection, end_s)
    connection.close()


def trend_ms(reader: Reader, span_s: int, points: int) -> tuple[str, int, float]:
    """Read a trend; return the table used, the number of points, and the shortest of some times, ms."""
    best_s = float("inf")
    for _ in range(_REPEATS):
        begun_s = time.perf_counter()
        trend = reader.trend((END_S - span_s) * _US, END_S * _US, points)
        best_s = min(best_s, time.perf_counter() - begun_s)
    return trend.source, len(trend.points), 1e3 * best_s


def _fill(
    connection: sqlite3.Connection,
    table: SummaryTable,
    rows: int,
    summarised: list[tuple[int, Column]],
    random: np.random.Generator,
    end_s: int,
) -> None:
    names = [column_name(part, number) for number, _ in summarised for part in SUMMARY_PARTS]
    fields = ["key", "epoch", "n", "n_valid", "worst", "lost", *names]
    insert = (
        f"INSERT OR REPLACE INTO {table.name} ({', '.join(fields)}) VALUES ({', '.join('?' * len(fields))})"  # noqa: S608
    )
    first_s = end_s - rows * table.span_s
    for begin in range(0, rows, _AT_ONCE):
        count = min(_AT_ONCE, rows - begin)
        connection.execute("BEGIN")
        connection.executemany(
            insert, _rows(table, first_s + begin * table.span_s, count, summarised, random)
        )
        connection.execute("COMMIT")


def _rows(
    table: SummaryTable,
    first_s: int,
    count: int,
    summarised: list[tuple[int, Column]],
    random: np.random.Generator,
) -> Iterator[list[int | None]]:
    """Rows in which the beam wanders over the whole area; a longer span has a larger scatter."""
    widths = random.exponential(1.0, (count, len(summarised), 2)) + 1.5
    parts = []
    for index, (_, column) in enumerate(summarised):
        scatter = _SCATTER_STEPS[column.unit] * (1 if table is SECONDS else 4)
        phase = 2 * np.pi * (first_s + np.arange(count) * table.span_s) / (5 * DAY_S)
        mean = (50.0 if column.unit == "mm" else 5.0) * np.sin(phase + index) * 10**column.decimals
        mean += random.normal(0, scatter, count)
        below, above = (np.rint(widths[:, index] * scatter).astype(int)).T
        parts.append([np.rint(mean).astype(int), random.integers(30, 50, count), below, above])
    numbers = np.array(parts).reshape(-1, count).T.tolist()
    for row, of_row in enumerate(numbers):
        n, t_s = 20 * table.span_s, first_s + row * table.span_s
        lost = 2 * 65536 + 1 if row % 1000 == 0 else None
        yield [t_s * 1000, 1, n, n if lost is None else n // 2, lost, lost, *of_row]


def _fill_measurements(
    connection: sqlite3.Connection, columns: tuple[Column, ...], random: np.random.Generator, end_s: int
) -> None:
    names = [column_name(part, number) for number in range(len(columns)) for part in ("value", "sigma")]
    fields = ["epoch", "t_us", "sequence", "t_ns", "frames", "valid", *names]
    insert = f"INSERT INTO measurements ({', '.join(fields)}) VALUES ({', '.join('?' * len(fields))})"  # noqa: S608
    values = random.integers(-1_000_000, 1_000_000, (72_000, len(columns))).tolist()
    rows = (
        [1, (end_s - 3600) * _US + 50_000 * number, number, 50_000_000 * number, 20, 1]
        + [part for value in of_row for part in (value, 40)]
        for number, of_row in enumerate(values)
    )
    connection.execute("BEGIN")
    connection.executemany(insert, rows)
    connection.execute("COMMIT")


def _fill_events(connection: sqlite3.Connection, end_s: int) -> None:
    detail = (
        '{"code": "spot_missing", "remedy": "switch the laser on and check that its beam enters the window"}'
    )
    insert = (
        "INSERT INTO events (epoch, t_us, severity, kind, of, text, detail, held_back) "
        "VALUES (1, ?, 2, 'cause_came', 'front', 'no laser spot', ?, 0)"
    )
    step_us = 365 * DAY_S * _US // 100_000
    connection.execute("BEGIN")
    connection.executemany(insert, ((end_s * _US - number * step_us, detail) for number in range(100_000)))
    connection.execute("COMMIT")


def main(arguments: list[str] | None = None) -> int:
    """Make a year of history, print its size and the times of its trends."""
    parser = Parser("benchmarks.history", __doc__)
    parser.add_argument("--keep", type=Path, metavar="FILE", help="where to leave the year")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        path = options.keep or Path(folder) / "history.db"
        make_history(path)
        print(f"a year: {path.stat().st_size / 1e6:.0f} MB")
        with Reader(path) as reader:
            for name, span_s in SPANS.items():
                for points in (500, 2000):
                    source, count, took_ms = trend_ms(reader, span_s, points)
                    print(f"{name:>8} in {points:4} points: {took_ms:6.1f} ms, {count} points from {source}")
            begun_s = time.perf_counter()
            reader.events(0, 2**62, limit=100)
            print(f"the newest 100 of 100,000 events: {1e3 * (time.perf_counter() - begun_s):.1f} ms")
            ((last,),) = reader.rows("SELECT max(id) FROM measurements")
            begun_s = time.perf_counter()
            reader.measurements_after(last - 1200, 1200)
            print(f"a minute of measurements: {1e3 * (time.perf_counter() - begun_s):.1f} ms")
    return 0


if __name__ == "__main__":
    end(main, "benchmarks.history")
