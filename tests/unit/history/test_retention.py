"""Removal from a history that grows, with limits made small."""

from dataclasses import replace
from pathlib import Path

import pytest
from support.history import START_S, US, batch, event, record_seconds, sample, state, store, write_seconds

from altd.history import retention
from altd.history.reader import Reader
from altd.history.records import ClockSet
from altd.history.schema import MINUTES, SECONDS
from altd.status.event_log import EventKind


def read(folder: Path) -> Reader:
    return Reader(folder / "history.db")


def test_measurements_go_after_an_hour_and_summaries_stay(tmp_path: Path) -> None:
    writing = store(tmp_path)
    for minute in range(0, 121, 10):
        t_s = START_S + 60 * minute
        writing.write(batch(t_s + 1, [sample(t_s, sequence=minute)]))
    writing.end(None)
    with read(tmp_path) as reader:
        assert [one.sequence for one in reader.measurements_after(0, 99)] == [70, 80, 90, 100, 110, 120]
        assert len(list(reader.summaries(SECONDS, 0, 2**62))) == 13


def test_measurements_of_before_a_restart_go_when_the_daemon_has_run_for_an_hour(tmp_path: Path) -> None:
    first = store(tmp_path)
    first.write(batch(START_S + 1, [sample(START_S, sequence=1)]))
    first.end(None)
    second = store(tmp_path)
    back_s = START_S - 86_400  # the clock was wrong by a day
    second.write(batch(back_s + 1, [sample(back_s, sequence=2)]))
    with read(tmp_path) as reader:
        assert [one.sequence for one in reader.measurements_after(0, 99)] == [1, 2]
    second.write(batch(back_s + 3700, [sample(back_s + 3699, sequence=3)]))
    second.end(None)
    with read(tmp_path) as reader:
        assert [one.sequence for one in reader.measurements_after(0, 99)] == [3]


def test_measurements_are_bounded_by_number_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retention, "MAX_MEASUREMENTS", 50)
    record_seconds(tmp_path, START_S, [10.0] * 10)
    with read(tmp_path) as reader:
        assert len(reader.measurements_after(0, 999)) == 50


def test_seconds_are_bounded_and_the_oldest_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retention, "SECONDS", replace(SECONDS, max_rows=20))
    record_seconds(tmp_path, START_S, [10.0] * 50, rate=1)
    with read(tmp_path) as reader:
        rows = [row.t_us // US - START_S for row in reader.summaries(SECONDS, 0, 2**62)]
        assert rows == list(range(30, 50))
        assert len(list(reader.summaries(MINUTES, 0, 2**62))) == 1


def test_the_oldest_is_told_by_epoch_and_not_by_a_clock_that_was_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retention, "SECONDS", replace(SECONDS, max_rows=20))
    future_s, past_s = START_S + 10 * 365 * 86_400, START_S
    writing = store(tmp_path)
    write_seconds(writing, future_s, [10.0] * 20, rate=1)
    writing.write(batch(past_s, [ClockSet(past_s * US)]))
    write_seconds(writing, past_s, [11.0] * 15, rate=1)
    writing.end(None)
    with read(tmp_path) as reader:
        rows = [row.t_us // US for row in reader.summaries(SECONDS, 0, 2**62)]
    assert rows == [*range(past_s, past_s + 15), *range(future_s + 15, future_s + 20)]


def test_a_clock_that_jumps_far_ahead_deletes_no_summary(tmp_path: Path) -> None:
    writing = store(tmp_path)
    write_seconds(writing, START_S, [10.0] * 20, rate=1)
    ahead_s = START_S + 3 * 365 * 86_400
    writing.write(batch(ahead_s + 1, [ClockSet(ahead_s * US), sample(ahead_s)]))
    writing.end(None)
    with read(tmp_path) as reader:
        assert len(list(reader.summaries(SECONDS, 0, 2**62))) == 21


@pytest.mark.long
def test_the_size_is_bounded_seconds_go_before_minutes_and_it_is_said(tmp_path: Path) -> None:
    limit = 13 << 20  # of which 12 MB are held in reserve
    writing = store(tmp_path, max_bytes=limit)
    notices = []
    path = tmp_path / "history.db"
    for part in range(80):
        items = [state(START_S + part * 400 + n, 4, f"reason_{part}") for n in range(400)]
        items += [sample(START_S + part * 400 + n, 10.0 + n) for n in range(0, 400, 1)]
        ordered = sorted(items, key=lambda item: item.wall_us)
        written = writing.write(batch(START_S + part * 400 + 401, ordered))
        notices += written.notices
        files = sum(file.stat().st_size for file in tmp_path.iterdir())
        assert files < limit
    writing.end(None)
    texts = [notice.text for notice in notices if notice.kind is EventKind.HISTORY]
    assert texts == ["new history file created", "to free space, the oldest seconds were deleted"]
    with read(tmp_path) as reader:
        seconds = [row.t_us // US - START_S for row in reader.summaries(SECONDS, 0, 2**62)]
        assert len(list(reader.summaries(MINUTES, 0, 2**62))) == -(-80 * 400 // 60)
    assert seconds[-1] == 80 * 400 - 1
    assert 3600 <= len(seconds) < 30_000
    assert path.stat().st_size < limit


def test_the_oldest_of_the_least_severe_events_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retention, "MAX_EVENTS", 30)
    monkeypatch.setattr(retention, "_EVENTS_AT_ONCE", 10)
    writing = store(tmp_path)
    notices = []
    for number in range(40):
        severity = 4 if number < 10 else 1
        one = event(number, START_S + number, EventKind.CAUSE_CAME, severity, f"{number}")
        notices += writing.write(batch(START_S + number, [], [one])).notices
    writing.end(None)
    with read(tmp_path) as reader:
        left = sorted(int(one.text) for one in reader.events(0, 2**62, ["cause_came"]))
    assert left == [*range(10), *range(29, 40)]
    assert "to free space, the oldest events were deleted" in [notice.text for notice in notices]


@pytest.mark.parametrize("kind", [EventKind.REQUEST, EventKind.RECORDING, EventKind.SELF_CHECK])
def test_what_is_asked_for_without_end_pushes_out_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: EventKind
) -> None:
    monkeypatch.setattr(retention, "MAX_EVENTS", 60)
    monkeypatch.setattr(retention, "MAX_REQUEST_EVENTS", 20)
    monkeypatch.setattr(retention, "_EVENTS_AT_ONCE", 5)
    notices = []
    for begin in range(0, 100, 50):
        writing = store(tmp_path)
        for number in range(begin, begin + 50):
            asked = [event(number, START_S + number, kind, severity=1, text=f"{number}")]
            others = [event(number, START_S + number, text=f"{number}")] if number < 30 else []
            notices += writing.write(batch(START_S + number, [], [*others, *asked])).notices
        writing.end(None)
    with read(tmp_path) as reader:
        assert [int(one.text) for one in reader.events(0, 2**62, ["state"])] == [*range(29, -1, -1)]
        left = [int(one.text) for one in reader.events(0, 2**62, [kind])]
    assert left == [*range(99, 99 - len(left), -1)]
    assert 15 <= len(left) <= 20
    assert f"to free space, the oldest {kind} events were deleted" in [notice.text for notice in notices]
