"""When daemons ran before a start, and how much of it was valid: histories written by hand, read back.

START_S is 08:00:00Z; of 20 measurements a second each is valid or not as the test says.
"""

import sqlite3
from pathlib import Path
from typing import Any

import pytest
from support.history import ABOUT, START_S, US, batch, record_seconds, state, store, write_seconds

from altd.history.reader import Reader
from altd.history.records import ClockSet
from altd.history.running import before_start
from altd.history.schema import UnusableFileError
from altd.status.availability import Availability, Before

HOUR_S = 3600
VALID, LOST = 10.0, None


def ran(folder: Path, first_s: int, seconds: int, x_mm: float | None = VALID) -> None:
    """A daemon that ran for so long, with four measurements a second."""
    record_seconds(folder, first_s, [x_mm] * seconds, rate=4)


def before(folder: Path, start_s: float, back_s: float = HOUR_S) -> Before:
    with Reader(folder / "history.db") as reader:
        return before_start(reader, round(start_s * US), back_s)


def last_hour(folder: Path, start_s: float) -> dict[str, Any]:
    """The availability of the hour before a daemon's start, at that start."""
    availability = Availability(0)
    availability.before = before(folder, start_s)
    return availability.spans()["last_hour"].as_object()


@pytest.mark.parametrize(
    ("runs", "start_s", "valid_s", "lost_s"),
    [
        ([(0, 120, VALID), (300, 60, LOST)], 400, 120, {"not_running": 220, "spot_missing": 60}),
        ([(0, 60, VALID), (100, 30, VALID)], 100, 60, {"not_running": 40}),
        ([(0, 60, VALID), (10 * HOUR_S, 60, VALID)], 100, 60, {"not_running": 40}),
        ([(0, 120, VALID), (60, 120, LOST)], 180, 60, {"spot_missing": 120}),
    ],
    ids=[
        "it adds up",
        "its own is not counted twice",
        "a wrong clock's future is none",
        "a clock was set back",
    ],
)
def test_what_ran_stood_still_and_was_lost_before_the_start_adds_up(
    tmp_path: Path,
    runs: list[tuple[int, int, float | None]],
    start_s: int,
    valid_s: float,
    lost_s: dict[str, float],
) -> None:
    for first_s, seconds, x_mm in runs:
        ran(tmp_path, START_S + first_s, seconds, x_mm)
    shown = last_hour(tmp_path, START_S + start_s)
    assert shown["observed_s"] == pytest.approx(start_s, abs=1)
    assert shown["valid_s"] == pytest.approx(valid_s, abs=1)
    assert shown["lost_s"] == pytest.approx(lost_s, abs=2)
    assert shown["share"] == pytest.approx(valid_s / start_s, abs=0.005)


def test_a_minute_half_valid_counts_half(tmp_path: Path) -> None:
    record_seconds(tmp_path, START_S, [VALID] * 30 + [LOST] * 30, rate=4)
    shown = last_hour(tmp_path, START_S + 60)
    assert shown["valid_s"] == pytest.approx(30, abs=1)
    assert shown["lost_s"] == pytest.approx({"spot_missing": 30}, abs=2)


def test_time_without_any_measurement_is_lost_to_what_the_unit_said(tmp_path: Path) -> None:
    writing = store(tmp_path)
    for second in range(60):
        writing.write(batch(START_S + second, [state(START_S + second, 4, "camera_failed")]))
    writing.end(None)
    assert last_hour(tmp_path, START_S + 60)["lost_s"] == pytest.approx({"camera_failed": 60}, abs=1)


def test_what_was_more_than_a_day_ago_is_told_by_hours(tmp_path: Path) -> None:
    """Ten seconds three days ago, in an hour of its own, and ten seconds a day ago to the minute."""
    day_s = 24 * HOUR_S
    ran(tmp_path, START_S - 3 * day_s, 10)
    ran(tmp_path, START_S - day_s - 5, 10, LOST)
    availability = Availability(0)
    availability.before = before(tmp_path, START_S, 31 * day_s)
    month = availability.spans()["last_31_days"].as_object()
    assert month["valid_s"] == pytest.approx(10, abs=1)
    assert month["lost_s"] == pytest.approx({"spot_missing": 10, "not_running": 3 * day_s - 20}, abs=2)
    day = availability.spans()["last_day"].as_object()
    assert day["lost_s"] == pytest.approx({"spot_missing": 5, "not_running": day_s - 5}, abs=2)


def test_no_more_than_the_span_is_told_and_nothing_before_the_first_record(tmp_path: Path) -> None:
    ran(tmp_path, START_S, 240)
    assert before(tmp_path, START_S + 240, back_s=90).known_s == 90
    spans = before(tmp_path, START_S + 240, back_s=90).spans
    assert sum(span.length_s for span in spans) == pytest.approx(90, abs=1)
    assert before(tmp_path, START_S + 240).known_s == pytest.approx(240, abs=1)


def test_a_history_that_has_just_begun_knows_nothing(tmp_path: Path) -> None:
    ran(tmp_path, START_S, 10)
    assert before(tmp_path, START_S) == Before()


@pytest.mark.parametrize("step_s", [-7200, -90, 90, 1_000_000])
def test_a_clock_that_was_set_while_a_daemon_ran_parts_nothing(tmp_path: Path, step_s: int) -> None:
    """Two minutes valid, then the clock is set, then a minute lost: three minutes, however far it was set."""
    writing = store(tmp_path)
    write_seconds(writing, START_S, [VALID] * 120, rate=4)
    set_s = START_S + 120 + step_s
    writing.write(batch(set_s, [ClockSet(set_s * US)]))
    write_seconds(writing, set_s, [LOST] * 60, rate=4)
    writing.end(batch(set_s + 61))
    shown = last_hour(tmp_path, set_s + 100)
    assert shown["valid_s"] == pytest.approx(120, abs=2)
    assert shown["lost_s"] == pytest.approx({"spot_missing": 60, "not_running": 40}, abs=3)
    assert shown["observed_s"] == pytest.approx(220, abs=3)


def test_this_daemons_own_time_before_its_clock_was_set_is_not_counted_twice(tmp_path: Path) -> None:
    """A unit without a battery: it starts in 1970, and a time server sets its clock after a minute."""
    ran(tmp_path, START_S, 60)
    writing = store(tmp_path)
    write_seconds(writing, 1000, [VALID] * 60, rate=4)
    start_s = START_S + 200
    set_s = start_s + 60
    writing.write(batch(set_s, [ClockSet(set_s * US)]))
    write_seconds(writing, set_s, [VALID] * 10, rate=4)
    shown = last_hour(tmp_path, start_s)
    writing.end(None)
    assert shown["valid_s"] == pytest.approx(60, abs=2)
    assert shown["lost_s"] == pytest.approx({"not_running": 140}, abs=2)


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE minutes SET n_valid = n + 1",
        "UPDATE minutes SET n = 'many'",
        "UPDATE epochs SET began_us = 'then'",
    ],
)
def test_a_damaged_file_is_said_and_not_believed(tmp_path: Path, damage: str) -> None:
    ran(tmp_path, START_S, 5)
    with sqlite3.connect(tmp_path / "history.db") as connection:
        connection.execute(damage)
    connection.close()
    with pytest.raises(UnusableFileError, match="damaged"):
        before(tmp_path, START_S + 10)


def test_a_target_of_any_name_is_taken_off_the_reason(tmp_path: Path) -> None:
    writing = store(tmp_path, ABOUT)
    writing.write(batch(START_S, [state(START_S, 2, "my_own_target_cut_by_edge")]))
    writing.end(None)
    (span,) = before(tmp_path, START_S + 1).spans
    assert span.lost_to == "cut_by_edge"
