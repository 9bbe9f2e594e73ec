"""The outbox: what is complete is queued once, in order, and stays until it is acknowledged."""

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from support.history import ABOUT, MAX_BYTES, START_S, US, batch, sample, state, store

from altd.history import retention
from altd.history.reader import Reader
from altd.history.records import ClockSet, Item, OutboxMark, QueuedSecond
from altd.history.schema import SummaryTable, UnusableFileError
from altd.history.store import Store


def queueing(folder: Path) -> Store:
    return Store(folder / "history.db", MAX_BYTES, ABOUT, has_outbox=True)


def seconds(first: int, count: int) -> list[Item]:
    times = range(START_S + first, START_S + first + count)
    return [item for t_s in times for item in (state(t_s), sample(t_s + 0.1, 10.0))]


def write(
    writing: Store, at_s: float, items: list[Item], acknowledged: tuple[str, int] | None = None
) -> OutboxMark:
    mark = writing.write(replace(batch(START_S + at_s, items), acknowledged=acknowledged)).outbox
    assert mark is not None
    return mark


def queued(folder: Path, mark: OutboxMark, after: int = 0) -> list[QueuedSecond]:
    with Reader(folder / "history.db") as reader:
        return reader.queued(mark.stream, after, mark.complete, 1000)


def test_a_second_is_complete_when_nothing_can_change_it_any_more(tmp_path: Path) -> None:
    writing = queueing(tmp_path)
    mark = write(writing, 2.0, seconds(0, 2))
    assert (mark.oldest, mark.complete) == (1, 0)
    mark = write(writing, 7.0, seconds(6, 1))
    assert (mark.oldest, mark.complete, mark.waiting) == (1, 2, 2), "the third may get more"
    found = queued(tmp_path, mark)
    assert [(each.sequence, each.epoch, each.point.t_us) for each in found] == [
        (1, 1, START_S * US),
        (2, 1, (START_S + 1) * US),
    ]
    assert found[0].point.values["x_mm"].mean == 10.0
    writing.end(None)


def test_only_this_openings_acknowledgement_deletes_and_no_sequence_comes_again(tmp_path: Path) -> None:
    writing = queueing(tmp_path)
    mark = write(writing, 20.0, seconds(0, 10))
    assert mark.complete == 10
    assert write(writing, 21.0, [], ("another", 10)).oldest == 1
    mark = write(writing, 22.0, [], (mark.stream, 4))
    assert (mark.oldest, mark.dropped) == (5, 0)
    assert [each.sequence for each in queued(tmp_path, mark)] == [5, 6, 7, 8, 9, 10]
    mark = write(writing, 23.0, [], (mark.stream, 10))
    assert (mark.oldest, mark.complete, mark.waiting) == (11, 10, 0)
    writing.end(None)
    later = queueing(tmp_path)
    again = write(later, 40.0, seconds(30, 2))
    assert (again.oldest, again.complete, again.file) == (11, 12, mark.file)
    assert again.stream != mark.stream
    with pytest.raises(UnusableFileError, match="was opened again"):
        queued(tmp_path, mark)
    later.end(None)


def test_a_crash_loses_no_second_and_completes_those_that_were_open(tmp_path: Path) -> None:
    writing = queueing(tmp_path)
    assert write(writing, 2.0, seconds(0, 2)).complete == 0
    writing.end(None)  # as by SIGKILL: the epoch is not ended
    later = queueing(tmp_path)
    mark = write(later, 3.0, seconds(2, 1))
    assert mark.complete == 2
    assert [each.epoch for each in queued(tmp_path, mark)] == [1, 1]
    later.end(None)


def test_what_a_clock_that_is_set_ends_is_complete(tmp_path: Path) -> None:
    writing = queueing(tmp_path)
    mark = write(writing, -97.0, [*seconds(0, 2), ClockSet((START_S - 100) * US), *seconds(-100, 1)])
    assert (mark.complete, [each.point.t_us for each in queued(tmp_path, mark)]) == (
        2,
        [START_S * US, (START_S + 1) * US],
    )
    mark = write(writing, -50.0, [])
    assert [(each.sequence, each.epoch) for each in queued(tmp_path, mark)] == [(1, 1), (2, 1), (3, 2)]
    writing.end(None)


def test_what_the_history_deletes_unacknowledged_is_counted_over_restarts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retention, "SECONDS", SummaryTable("seconds", 1, 6))
    writing = queueing(tmp_path)
    write(writing, 20.0, seconds(0, 10))
    mark = write(writing, 21.0, [])
    assert (mark.oldest, mark.complete, mark.dropped) == (5, 10, 4)
    writing.end(None)
    later = queueing(tmp_path)
    write(later, 40.0, seconds(30, 2))
    mark = write(later, 41.0, [])
    assert (mark.oldest, mark.complete, mark.dropped) == (7, 12, 6)
    later.end(None)
    with closing(sqlite3.connect(tmp_path / "history.db")) as foreign:
        texts = [text for (text,) in foreign.execute("SELECT text FROM events WHERE kind = 'history'")]
    assert "to free space, the oldest summaries of 1 s that no ingest has acknowledged were deleted" in texts


def test_without_an_outbox_nothing_is_queued(tmp_path: Path) -> None:
    writing = store(tmp_path)
    assert writing.write(batch(START_S + 20, seconds(0, 10))).outbox is None
    writing.end(None)
    with closing(sqlite3.connect(tmp_path / "history.db")) as foreign:
        assert foreign.execute("SELECT count(*) FROM outbox").fetchone() == (0,)
