"""``altd export`` and ``altd events``: hand-made histories, read by pandas' peers: csv and pyarrow."""

import argparse
import csv
import io
import json
import shutil
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pyarrow.parquet
import pytest
from support.cli import altd_here, refusal
from support.history import START_S, batch, event, sample, state, store, write_seconds

from altd.answers.events import answer
from altd.cli.arguments import time_us
from altd.history.opening import DAMAGED, move_aside
from altd.history.records import ClockSet
from altd.reasons import Reason
from altd.status.event_log import EventKind


@pytest.fixture
def history(tmp_path: Path) -> Path:
    writing = store(tmp_path)
    write_seconds(writing, START_S, [10.0, None, 11.5], rate=2)
    items = [state(START_S + 5, 3, "simulated"), sample(START_S + 5.2, 12.0, 9, Reason.SIMULATED)]
    events = [
        event(1, START_S + 1, EventKind.CAUSE_CAME, 2, "no laser\x1b[2J spot"),
        event(2, START_S + 2, EventKind.REQUEST, 1, "a self-check was asked for"),
    ]
    writing.write(batch(START_S + 6, items, events))
    writing.end(None)
    return tmp_path / "history.db"


def table(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


class TestExport:
    def test_seconds_as_csv(self, history: Path) -> None:
        said = altd_here("export", "--history", history, "--to", "2026-11-20T08:00:05Z")
        assert (said.status, said.err) == (0, "")
        first, second, third = table(said.out)
        assert (first["time"], first["n"], first["n_valid"]) == ("2026-11-20T08:00:00.000Z", "2", "2")
        assert (first["x_mm"], first["sigma_x_mm"], first["min_x_mm"]) == ("10.0", "0.004", "10.0")
        assert (first["worst"], first["lost_to"]) == ("good", "")
        assert (second["n"], second["n_valid"], second["x_mm"], second["max_yaw_deg"]) == ("2", "0", "", "")
        assert (second["worst"], second["worst_cause"]) == ("out_of_specification", "spot_missing")
        assert second["lost_to"] == "front_spot_missing"
        assert third["x_mm"] == "11.5"

    def test_measurements_into_a_file_as_parquet(self, history: Path, tmp_path: Path) -> None:
        to = tmp_path / "t.parquet"
        form = ("--every", "measurement", "--format", "parquet")
        said = altd_here("export", "--history", history, *form, "-o", to)
        assert (said.status, said.out, said.err) == (0, "", "")
        read = pyarrow.parquet.read_table(to)
        rows = read.to_pylist()
        assert [row["valid"] for row in rows] == [True, True, False, False, True, True, True]
        assert rows[-1]["time"] == datetime(2026, 11, 20, 8, 0, 5, 200_000, UTC)
        assert (rows[-1]["x_mm"], rows[-1]["rear_y_mm"], rows[-1]["status"]) == (12.0, -3.413, "simulated")
        assert (rows[2]["x_mm"], rows[2]["sigma_x_mm"], rows[2]["front_x_mm"]) == (None, None, None)
        assert read.schema.field("yaw_deg").metadata[b"unit"] == "°".encode()
        assert json.loads(read.schema.metadata[b"altd.unit_serial"]) == "TEST-1"

    @pytest.mark.parametrize(("every", "most"), [("second", 2), ("minute", 2), ("measurement", 4)])
    def test_rows_of_one_time_are_told_apart_by_the_epoch_of_the_clock(
        self, tmp_path: Path, every: str, most: int
    ) -> None:
        writing = store(tmp_path)
        write_seconds(writing, START_S, [1.0] * 3, rate=2)
        writing.write(batch(START_S + 4, [ClockSet(START_S * 10**6)]))
        write_seconds(writing, START_S, [2.0] * 3, rate=2)
        writing.end(None)
        path = tmp_path / "history.db"
        rows = table(altd_here("export", "--history", path, "--every", every).out)
        at_once = [row for row in rows if row["time"] == rows[0]["time"]]
        assert len(at_once) == 2
        assert [(row["epoch"], row["x_mm"]) for row in at_once] == [("1", "1.0"), ("2", "2.0")]
        assert len({(row["epoch"], row["time"]) for row in rows}) == len(rows) >= most

    @pytest.mark.parametrize("every", ["minute", "hour"])
    def test_minutes_and_hours(self, history: Path, every: str) -> None:
        (row,) = table(altd_here("export", "--history", history, "--every", every).out)
        assert (row["n"], row["n_valid"], row["x_mm"], row["max_x_mm"]) == ("7", "5", "11.0", "12.0")

    def test_a_time_is_utc_or_so_long_ago(self, history: Path) -> None:
        ranges = {
            ("--from", "2026-11-20T08:00:02"): 2,
            ("--from", "2026-11-20T09:00:02+01:00"): 2,
            ("--from", "2026-11-20T08:00:01Z", "--to", "2026-11-20T08:00:02Z"): 1,
            ("--from", "2026-11-20"): 4,
            ("--to", "-2h"): 4,
            ("--from", "-1s"): 0,
            ("--to", "-99999d"): None,
            ("--from", "-100000000d"): None,
        }
        for given, count in ranges.items():
            said = altd_here("export", "--history", history, *given)
            if count is None:
                assert "is not a time; possible: 2026-11-20T08:15:30Z, 02:10, or -2h" in refusal(said)
            else:
                assert len(table(said.out)) == count

    @pytest.mark.parametrize("zone", ["UTC", "Asia/Kolkata"])
    def test_a_clock_time_is_the_last_one_in_local_time(
        self, monkeypatch: pytest.MonkeyPatch, zone: str
    ) -> None:
        monkeypatch.setenv("TZ", zone)
        time.tzset()
        try:
            now = datetime.now().astimezone()
            for minutes in (-2, 2):
                wall = now + timedelta(minutes=minutes)
                days = 1 if wall > now else 0
                wanted = wall.replace(second=30, microsecond=0) - timedelta(days=days)
                assert time_us(f"{wall:%H:%M}:30") == wanted.timestamp() * 1e6
                assert time_us(f"{wall:%H:%M}") == wanted.replace(second=0).timestamp() * 1e6
            with pytest.raises(argparse.ArgumentTypeError, match="is not a time"):
                time_us("24:10")
        finally:
            monkeypatch.undo()
            time.tzset()

    def test_while_it_is_written_and_from_a_copy(self, history: Path, tmp_path: Path) -> None:
        writing = store(tmp_path)
        writing.write(batch(START_S + 21, [sample(START_S + 20, 20.0)]))
        assert table(altd_here("export", "--history", history).out)[-1]["x_mm"] == "20.0"
        writing.end(None)
        copy = tmp_path / "laptop" / "of_unit.db"
        copy.parent.mkdir()
        shutil.copy(history, copy)
        assert table(altd_here("export", "--history", copy).out)[-1]["x_mm"] == "20.0"

    @pytest.mark.parametrize(
        ("arguments", "line"),
        [
            (("--history", "none.db"), "none.db: No such file or directory; the daemon creates it"),
            (("--history", "."), ".: is not a regular file"),
            (("--history", "text.db"), "text.db: cannot be read: file is not a database"),
            (("--history", "h.db", "--config", "altd.toml"), "--config: names the history file"),
            (
                ("--history", "h.db", "--from", "2026-11-20", "--to", "2026-11-19"),
                "--to: is not after --from",
            ),
            (("--history", "h.db", "--format", "parquet"), "--format parquet: needs a file: -o FILE"),
            (("--history", "h.db", "-o", "h.db"), "h.db: is the input"),
            (("--history", "h.db", "--from", "yesterday"), "--from: 'yesterday' is not a time; possible: "),
            ((), "missing, or --config FILE, because there is no "),
        ],
    )
    def test_what_cannot_be_is_one_line(
        self,
        history: Path,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        arguments: tuple[str, ...],
        line: str,
    ) -> None:
        monkeypatch.chdir(tmp_path)
        history.rename("h.db")
        Path("text.db").write_text("x" * 1000)
        assert line in refusal(altd_here("export", *arguments))

    @pytest.mark.parametrize(
        "statement",
        [
            "UPDATE columns SET key = 'x\n\x1b[2J' WHERE number = 0",
            "UPDATE columns SET decimals = -400 WHERE number = 0",
            "UPDATE columns SET key = 'x', unit = x'00ff' WHERE number = 0",
            "UPDATE seconds SET above_0 = NULL",
            "UPDATE seconds SET mean_0 = 1e308",
            "INSERT INTO columns VALUES (900, 'z', 'mm', 4, 'z', 1, 0)",
            "INSERT INTO columns VALUES (40, 'z', 'mm', 4, 'z', 1, 0)",
            "UPDATE columns SET key = 'sigma_x_mm', is_summarised = 1 WHERE number = 1",
            "DROP TABLE seconds; CREATE VIEW seconds AS WITH RECURSIVE r(i) AS (SELECT 1 UNION ALL "
            "SELECT i + 1 FROM r) SELECT i AS key, 1 AS n, 1 AS n_valid, 1 AS worst, 1 AS lost FROM r",
        ],
    )
    def test_a_forged_history_is_one_line(self, history: Path, statement: str) -> None:
        with sqlite3.connect(history) as foreign:
            foreign.executescript(statement)
        foreign.close()
        said = altd_here("export", "--history", history)
        assert said.status == 2
        assert said.err.count("\n") == 1
        assert said.err.startswith("altd export: ")
        assert "\x1b" not in said.err


class TestEvents:
    def test_are_lines_in_their_order_without_control_letters(self, history: Path) -> None:
        said = altd_here("events", "--history", history, "--from", "2026-11-20")
        assert (said.status, said.err) == (0, "")
        lines = said.out.splitlines()
        assert lines[1:] == [
            "2026-11-20T08:00:01.000Z began       no laser\\x1b[2J spot",
            "2026-11-20T08:00:02.000Z request     a self-check was asked for",
        ]
        assert lines[0].endswith("history     new history file created")

    def test_of_a_kind_and_a_time(self, history: Path) -> None:
        said = altd_here("events", "--history", history, "--kind", "request", "--format", "jsonl")
        (found,) = said.objects
        assert (found["time"], found["kind"], found["severity"]) == ("2026-11-20T08:00:02.000Z", "request", 1)
        before = altd_here("events", "--history", history, "--to", "2026-11-20T07:00")
        assert (before.status, before.out) == (0, "")
        assert before.err.startswith(
            "altd events: the history begins at 2026-11-20T08:00:00.000Z: nothing is "
        )
        word = altd_here("events", "--history", history, "--kind", "began", "--format", "jsonl").objects
        assert [row["kind"] for row in word] == ["cause_came"]

    def test_what_was_in_force_at_the_begin_of_a_window_comes_first(self, tmp_path: Path) -> None:
        writing = store(tmp_path)
        write_seconds(writing, START_S, [10.0] * 9)
        noted = [
            event(1, START_S - 9, EventKind.CAUSE_CAME, 4, "of the daemon before"),
            event(2, START_S, EventKind.STARTED, 2, "started"),
            event(3, START_S + 1, EventKind.STATE, 4, "failure"),
            event(4, START_S + 2, EventKind.CAUSE_CAME, 2, "no laser spot"),
            event(5, START_S + 3, EventKind.CAUSE_CAME, 1, "exposures were lost"),
            event(6, START_S + 4, EventKind.CAUSE_WENT, 1, "exposures were lost"),
            event(7, START_S + 8, EventKind.CAUSE_WENT, 2, "no laser spot"),
        ]
        writing.write(batch(START_S + 9, (), noted))
        writing.end(None)
        path = tmp_path / "history.db"
        said = altd_here(
            "events", "--history", path, "--from", "2026-11-20T08:00:06", "--to", "2026-11-20T09:00"
        )
        assert (said.status, said.err) == (0, "")
        assert said.out.splitlines() == [
            "at 2026-11-20T08:00:06.000Z in force, since:",
            "2026-11-20T08:00:00.000Z started     started",
            "2026-11-20T08:00:01.000Z state       failure",
            "2026-11-20T08:00:02.000Z began       no laser spot",
            "then:",
            "2026-11-20T08:00:08.000Z ended       no laser spot",
        ]
        later = altd_here(
            "events", "--history", path, "--from", "2026-11-20T08:05", "--to", "2026-11-20T09:00"
        )
        assert "but nothing was measured in the minute before: the unit was off" in later.out
        data = altd_here("events", "--history", path, "--from", "2026-11-20T08:00:06", "--format", "jsonl")
        assert [found["text"] for found in data.objects][:1] == ["no laser spot"], "data are events alone"

    def test_as_csv(self, history: Path) -> None:
        rows = table(altd_here("events", "--history", history, "--format", "csv").out)
        assert [row["kind"] for row in rows] == ["history", "cause_came", "request"]

    def test_a_kind_that_there_is_not_is_refused(self, history: Path) -> None:
        line = refusal(altd_here("events", "--history", history, "--kind", "requst"))
        assert line.endswith("did you mean `request`?")


def write(folder: Path, number: int, text: str) -> None:
    """As a daemon does that is started, notes an event and ends."""
    writing = store(folder)
    noted = event(number, START_S + number, EventKind.REQUEST, 1, text)
    writing.write(batch(START_S + number + 1, (), [noted]))
    writing.end(None)


def begin(file: Path) -> None:
    """As a daemon does before the first table is on its disk."""
    with closing(sqlite3.connect(file)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")


def test_goes_on_with_the_file_that_the_daemon_begins_anew(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    history = tmp_path / "history.db"
    write(tmp_path, 1, "the first")

    def pauses() -> Iterator[None]:
        yield
        write(tmp_path, 2, "the second")
        yield
        move_aside(history, DAMAGED)
        begin(history)
        yield  # it is seen that there is another file
        yield
        yield
        write(tmp_path, 1, "in a new file")
        yield
        yield
        raise KeyboardInterrupt

    pause = pauses()
    monkeypatch.setattr(time, "sleep", lambda seconds: next(pause))
    with pytest.raises(KeyboardInterrupt):
        answer(history, (0, 2**62), ("request",), "text", follow=True)
    said = [line.split(" request ")[1].strip() for line in capsys.readouterr().out.splitlines()]
    assert said == ["the first", "the second", "in a new file"]
