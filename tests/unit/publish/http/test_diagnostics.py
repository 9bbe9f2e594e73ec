"""The diagnostics: what there is in one archive that a foreign program opens, and what is missing by name."""

import csv
import json
import subprocess
import threading
import zipfile
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families
from support.evidence import calibration
from support.foreign import need_program
from support.history import START_S, WallClock, at, event, store, write_seconds
from support.history import batch as batch_of
from support.status_fixtures import checked

from altd.app.calibration_summary import summary_of
from altd.history.history import History
from altd.publish.http import diagnostics
from altd.status.board import Board
from altd.status.health import Health
from altd.status.unit import DiagnosticPart, PublishedUnit

from .calibration_files import Files
from .conftest import Answer, served_with

PATH = "/api/v1/diagnostics"
ALWAYS = {"README.txt", "status.json", "targets.json", "calibration.json", "metrics.txt"}
OF_HISTORY = {"events.jsonl", "trend.csv"}


@pytest.fixture
def clock() -> WallClock:
    """Two minutes after ``START_S`` on the clock of ``support.history``."""
    clock = WallClock(10**12 + 120 * 10**9)
    clock.offset_s = -1000.0
    return clock


@pytest.fixture
def recorded(tmp_path: Path) -> History:
    """Two minutes: x is 1 mm in the first and 2 mm in the second; three events, one of 40 days before."""
    need_program("unzip")  # before a thread is begun
    kept = store(tmp_path)
    kept.write(batch_of(START_S - 40 * 86_400, (), [event(1, START_S - 40 * 86_400, text="long ago")]))
    write_seconds(kept, START_S, [1.0] * 60 + [2.0] * 60, rate=2)
    html = [event(2, START_S + 1, text="<b>first</b>"), event(3, START_S + 2, text="second\u2028line")]
    kept.write(batch_of(START_S + 122, (), html))
    kept.end(None)
    return History(tmp_path / "history.db")


def opened(answer: Answer, folder: Path) -> Mapping[str, bytes]:
    """The archive's files, by Info-ZIP's own program."""
    assert (answer.status, answer.headers["content-type"]) == (200, "application/zip")
    (folder / "got.zip").write_bytes(answer.body)
    into = folder / "got"
    subprocess.run([need_program("unzip"), "-q", folder / "got.zip", "-d", into], check=True)
    return {
        path.relative_to(into).as_posix(): path.read_bytes() for path in into.rglob("*") if path.is_file()
    }


def readme(files: Mapping[str, bytes]) -> tuple[set[str], set[str]]:
    """The files that are listed, and those that are listed as missing."""
    told, _, missing = files["README.txt"].decode().partition("\nNot in it:\n")
    return {line.partition(":")[0] for line in told.splitlines()[2:] if line}, {
        line.partition(":")[0] for line in missing.splitlines()
    }


async def test_all_that_is_known_is_in_it(
    board: Board, health: Health, published: PublishedUnit, recorded: History, tmp_path: Path
) -> None:
    board.publish(at(START_S + 119.5, 2.0))
    published.self_check.publish(checked(1))
    published.calibration, published.calibration_files = (
        summary_of(calibration(), ("front",), "cal.json"),
        Files(),
    )
    published.diagnostics = (DiagnosticPart("versions.txt", "versions", lambda: b"altd 0.1.0\n"),)
    async with served_with(published, recorded) as unit:
        files = opened(answer := await unit.ask(PATH), tmp_path)
    assert (
        answer.headers["content-disposition"] == 'attachment; filename="altd-ALT-0007-20261120T080200Z.zip"'
    )
    assert set(files) == ALWAYS | OF_HISTORY | {"measurement.json", "self-check.json", "versions.txt"}
    assert readme(files) == (set(files) - {"README.txt"}, set())
    assert json.loads(files["status.json"])["serial"] == "ALT-0007"
    assert json.loads(files["measurement.json"])["x_mm"] == 2.0
    assert json.loads(files["self-check.json"])["verdict"] == "good"
    assert json.loads(files["calibration.json"])["unit"] == "TEST-1"
    assert files["versions.txt"] == b"altd 0.1.0\n"
    assert "altd_x_mm" in {
        each.name for each in text_string_to_metric_families(files["metrics.txt"].decode())
    }


async def test_events_and_trend_are_those_of_the_history(
    published: PublishedUnit, recorded: History, tmp_path: Path
) -> None:
    async with served_with(published, recorded) as unit:
        files = opened(await unit.ask(PATH), tmp_path)
    lines = files["events.jsonl"].decode().split("\n")
    assert lines.pop() == ""
    told = [json.loads(line)["text"] for line in lines]
    assert told[-2:] != told[-2:][::-1]
    assert [text for text in told if text in ("<b>first</b>", "second\u2028line", "long ago")] == [
        "second\u2028line",
        "<b>first</b>",
    ]
    rows = list(csv.DictReader(files["trend.csv"].decode().splitlines()))
    assert [(row["time"], float(row["x_mm"]), row["n"], row["n_valid"]) for row in rows] == [
        ("2026-11-20T08:00:00.000Z", pytest.approx(1.0), "120", "120"),
        ("2026-11-20T08:01:00.000Z", pytest.approx(2.0), "120", "120"),
    ]
    assert {"sigma_x_mm", "min_x_mm", "max_x_mm", "worst", "worst_cause", "lost_to"} <= set(rows[0])


@pytest.mark.long
async def test_what_cannot_be_had_is_named_and_costs_no_other(
    board: Board, health: Health, published: PublishedUnit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken() -> bytes:
        raise OSError(5, "Input/output error")

    is_over = threading.Event()
    monkeypatch.setattr(diagnostics, "_PART_TIMEOUT_S", 5.0)  # the other parts take less on a busy machine
    published.diagnostics = (
        DiagnosticPart("broken.txt", "breaks", broken),
        DiagnosticPart("slow.txt", "takes long", lambda: b"late" if is_over.wait(60) else b""),
        DiagnosticPart("well.txt", "is well", lambda: b"well\n"),
    )
    async with served_with(published, None) as unit:
        files = opened(await unit.ask(PATH), tmp_path)
        is_over.set()
    assert set(files) == ALWAYS | {"well.txt"}
    missing = {"measurement.json", "self-check.json", *OF_HISTORY, "broken.txt", "slow.txt"}
    assert readme(files) == (set(files) - {"README.txt"}, missing)
    said = files["README.txt"].decode()
    assert "broken.txt: [Errno 5] Input/output error" in said
    assert "slow.txt: it took longer than 5 s" in said
    assert "trend.csv: there is no history" in said
    assert "measurement.json: nothing was measured since the unit started" in said


async def test_a_part_that_is_too_long_ends_at_a_line_and_says_so(
    board: Board, health: Health, published: PublishedUnit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diagnostics, "MAX_PART_BYTES", 1000)
    published.diagnostics = (DiagnosticPart("long.txt", "is long", lambda: b"123456789012\n" * 1000),)
    async with served_with(published, None) as unit:
        files = opened(await unit.ask(PATH), tmp_path)
    assert files["long.txt"] == b"123456789012\n" * 76
    assert "long.txt: is long (its first 1000 bytes)" in files["README.txt"].decode()


async def test_names_that_are_no_names_break_nothing(
    board: Board, health: Health, published: PublishedUnit, tmp_path: Path
) -> None:
    published.facts = published.facts.model_copy(
        update={"serial": 'a/../b"\r\nX-Evil: 1\u202e<script>\ud800'}
    )
    async with served_with(published, None) as unit:
        answer = await unit.ask(PATH)
    assert "x-evil" not in answer.headers
    name = answer.headers["content-disposition"]
    assert name == 'attachment; filename="altd-a_.._b___X-Evil__1__script__-20261120T080200Z.zip"'
    assert b"a/../b" in opened(answer, tmp_path)["README.txt"].splitlines()[0]


@pytest.mark.parametrize(
    ("year", "dated"), [(1969, 1980), (1970, 1980), (2026, 2026), (2107, 2107), (2108, 2107), (9998, 2107)]
)
async def test_a_clock_that_is_set_wrong_is_no_obstacle(
    published: PublishedUnit, clock: WallClock, tmp_path: Path, year: int, dated: int
) -> None:
    """A zip archive has no dates before 1980 or after 2107."""
    clock.offset_s += datetime(year, 7, 1, tzinfo=UTC).timestamp() - START_S
    async with served_with(published, None) as unit:
        assert set(opened(await unit.ask(PATH), tmp_path)) == ALWAYS
    with zipfile.ZipFile(tmp_path / "got.zip") as archive:
        assert {entry.date_time[0] for entry in archive.infolist()} == {dated}
