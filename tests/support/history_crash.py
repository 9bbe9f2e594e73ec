"""Losses of a history whose daemon is killed: ``python -m support.history_crash --times 200``.

A child process records as the daemon does, with its board, its recorder and the real clock, 100 measurements
a second, and writes down when it published which. It is killed (SIGKILL) at a random moment, again and again
on one file. After each kill the file must be whole by SQLite's own check, hold every measurement of a batch
that was written, every one that was published a second or more before the kill, and none that was not
published.
"""

import argparse
import asyncio
import os
import random
import signal
import sqlite3
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NoReturn

TESTS = Path(__file__).parents[1]
RATE_HZ = 100
MAX_LOST_S = 1.0
_NOTE = struct.Struct("<qq")
FIRST_SEQUENCE_STEP = 1_000_000


class HistoryLostError(Exception):
    """A file that is not whole, or lacks more than it may."""


@dataclass(frozen=True, slots=True)
class Loss:
    """The cost of a kill: measurements, and the time from the first of them to the last one published."""

    measurements: int
    lost_s: float
    published: int
    batches: int = 0
    """Whose writing was begun."""


def write(
    path: Path,
    first: int,
    note: Callable[[int, int], object],
    begin: Callable[[int, int], object] = lambda last, t_ns: None,
) -> NoReturn:
    """Record without end; ``note`` receives the number of each measurement, and its monotonic time, ns.

    ``begin`` gets the last number of each batch when its writing begins: the batch before it is written.
    """
    from altd.history.columns import columns_of
    from altd.history.recorder import HistoryRecorder
    from altd.history.records import About, Batch, Sample, Written
    from altd.history.store import Store
    from altd.instruments.beam.instrument import QUANTITIES
    from altd.records import Measurement, Value
    from altd.runtime.clock import SystemClock
    from altd.status.board import Board
    from altd.status.event_log import EventLog
    from altd.status.health import Health
    from altd.status.state import UnitState

    class NotingStore(Store):
        def write(self, batch: Batch) -> Written:
            numbers = [item.measurement.sequence for item in batch.items if isinstance(item, Sample)]
            if numbers:
                begin(numbers[-1], time.monotonic_ns())
            return super().write(batch)

    async def run() -> None:
        clock = SystemClock()
        board, health = Board(clock, 1.0, QUANTITIES), Health(clock)
        store = NotingStore(path, 400 * 10**6, About(columns_of(QUANTITIES, ("front", "rear"))))
        state = UnitState(board, health, clock)
        recorder = HistoryRecorder(store, EventLog(clock), state.read, health.component("history"), clock)
        recording = asyncio.create_task(recorder.run())
        keys = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
        point = {"x_mm": Value(1.0), "y_mm": Value(2.0)}
        sequence = first
        while not recording.done():
            values = {key: Value(random.uniform(-50, 50), 0.004) for key in keys}
            now_ns = time.monotonic_ns()
            targets = {"front": point, "rear": point}
            measured = Measurement(sequence, now_ns, datetime.now(UTC), 20, QUANTITIES, values, targets)
            recorder.take(board.publish(measured))
            note(sequence, now_ns)
            sequence += 1
            await asyncio.sleep(1 / RATE_HZ)
        recording.result()

    asyncio.run(run())
    sys.exit(1)


def kill_once(path: Path, number: int, after_s: float) -> Loss:
    """Record, kill, and judge what is left; raises HistoryLostError."""
    first = number * FIRST_SEQUENCE_STEP
    reading, writing = os.pipe()
    command = ["env", f"PYTHONPATH={TESTS}", sys.executable, "-m", "support.history_crash"]
    command += ["--write", str(path), str(first), str(writing)]
    process = subprocess.Popen(command, pass_fds=(writing,), stderr=subprocess.PIPE)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        content = pipe.read(_NOTE.size)  # it publishes: from here on time counts
        time.sleep(after_s)
        process.send_signal(signal.SIGKILL)
        content += pipe.read()
    _, said = process.communicate()
    if not content:
        raise HistoryLostError(f"the recording did not begin: {said.decode()[-500:]}")
    whole = len(content) - len(content) % _NOTE.size
    notes = list(_NOTE.iter_unpack(content[:whole]))
    begun = [-1 - number for number, _ in notes if number < 0]
    stored = judged(path, first)
    if len(begun) > 1 and first + stored <= begun[-2]:
        raise HistoryLostError(f"measurement {begun[-2]} was written and is not there")
    loss = loss_of({number: t_ns for number, t_ns in notes if number >= 0}, first, stored)
    return replace(loss, batches=len(begun))


def judged(path: Path, first: int) -> int:
    """The number of measurements from this number on in the file; raises HistoryLostError if it is not whole.

    None of them may be missing in between, and the summaries must hold as many.
    """
    connection = sqlite3.connect(path)
    try:
        (said,) = connection.execute("PRAGMA integrity_check").fetchone()
        if said != "ok":
            raise HistoryLostError(f"the file is damaged: {said}")
        if not connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
            return 0  # cut before the first batch: there is a file, and nothing in it
        rows = connection.execute(
            "SELECT sequence FROM measurements WHERE sequence >= ? AND sequence < ? ORDER BY id",
            (first, first + FIRST_SEQUENCE_STEP),
        ).fetchall()
        (counted,) = connection.execute(
            "SELECT coalesce(sum(n), 0) FROM seconds WHERE epoch = (SELECT max(epoch) FROM epochs)"
        ).fetchone()
    except sqlite3.Error as error:
        raise HistoryLostError(f"the file cannot be read: {error}") from error
    finally:
        connection.close()
    stored = [sequence for (sequence,) in rows]
    if stored != list(range(first, first + len(stored))):
        raise HistoryLostError(f"measurements are missing in between: {stored[-5:]}")
    if stored and counted != len(stored):
        raise HistoryLostError(f"the summaries hold {counted} of {len(stored)} measurements")
    return len(stored)


def loss_of(published: Mapping[int, int], first: int, stored: int) -> Loss:
    """The published measurements that are missing (number: monotonic ns); HistoryLostError for too many."""
    if stored > len(published) + 1:
        raise HistoryLostError(f"{stored} are stored, and {len(published)} were published")
    lost = [t_ns for sequence, t_ns in published.items() if sequence >= first + stored]
    return Loss(len(lost), (max(lost) - min(lost)) * 1e-9 if lost else 0.0, len(published))


def main(arguments: list[str] | None = None) -> int:
    """Kill so often; say the worst loss. Status 1 when more was lost than may be."""
    parser = argparse.ArgumentParser(prog="support.history_crash")
    parser.add_argument("--times", type=int, default=200)
    parser.add_argument("--write", nargs=3, metavar=("FILE", "FIRST", "DESCRIPTOR"), help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.write:
        path, first, notes = options.write

        def tell(number: int, t_ns: int) -> None:
            os.write(int(notes), _NOTE.pack(number, t_ns))

        write(Path(path), int(first), tell, lambda last, t_ns: tell(-1 - last, t_ns))
    draw = random.Random(1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "history.db"
        losses = [kill_once(path, number, draw.uniform(0.0, 2.5)) for number in range(options.times)]
        size_mb = path.stat().st_size / 1e6
    lost_s = sorted(loss.lost_s for loss in losses)
    published = sum(loss.published for loss in losses)
    print(f"{len(losses)} kills, {published} measurements published, {size_mb:.1f} MB, no file damaged")
    print(f"lost: {lost_s[len(lost_s) // 2]:.2f} s in the median, {lost_s[-1]:.2f} s at most")
    return 0 if lost_s[-1] <= MAX_LOST_S else 1


if __name__ == "__main__":
    sys.exit(main())
