"""The loop's side: what is handed on, what is dropped, what is said; on a clock that the test drives."""

from __future__ import annotations

import asyncio
import gc
import shutil
import sqlite3
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.clock import settle
from support.history import ABOUT, MAX_BYTES, START_S, US, WallClock, at
from support.measurements import measurement

from altd.history import open_store, opening
from altd.history import recorder as recorder_module
from altd.history.reader import Reader
from altd.history.recorder import WRITE_INTERVAL_S, HistoryRecorder
from altd.history.records import Batch, Written
from altd.history.retention import Retention
from altd.history.schema import SECONDS
from altd.history.store import Store
from altd.instruments.beam.instrument import QUANTITIES
from altd.records import Measurement
from altd.status import event_log
from altd.status.board import Board
from altd.status.event_log import EventKind, EventLog
from altd.status.health import Component, Health, State
from altd.status.state import UnitState


class Recording:
    """A recorder with its board. Time passes only while the disk does nothing, or is held."""

    def __init__(self, folder: Path, store: Store | None = None, end_within_s: float = 60.0) -> None:
        self.clock = WallClock(10**12)
        self.board = Board(self.clock, 1.0, QUANTITIES)
        self.health = Health(self.clock)
        self.log = EventLog(self.clock)
        self.component: Component = self.health.component("history")
        self.path = folder / "history.db"
        state = UnitState(self.board, self.health, self.clock)
        self.recorder = HistoryRecorder(
            store or Store(self.path, MAX_BYTES, ABOUT), self.log, state.read, self.component, self.clock
        )
        self.published = 0
        self._task: asyncio.Task[None] | None = None
        self._end_within_s = end_within_s
        self._patches = pytest.MonkeyPatch()
        if isinstance(store, HeldStore):
            store.clock = self.clock

    async def __aenter__(self) -> Recording:
        self.clock.watch_devices()
        self._patches.setattr(recorder_module, "_END_TIMEOUT_S", self._end_within_s)
        self._task = asyncio.create_task(self.recorder.run())
        await settle()
        return self

    async def __aexit__(self, *_: object) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        self._patches.undo()

    def publish(self) -> None:
        self.published += 1
        now_s = self.clock.utc(self.clock.now_ns).timestamp()
        self.record(at(now_s - 0.1, 10.0, self.published))

    def record(self, measured: Measurement) -> None:
        self.recorder.take(self.board.publish(measured))

    async def pass_time(self, seconds: float, rate: float = 0.0) -> None:
        """``rate`` measurements a second are published meanwhile."""
        step_s = 0.2
        for _ in range(round(seconds / step_s)):
            for _ in range(round(rate * step_s)):
                self.publish()
            await self.clock.advance(step_s)

    async def until(self, true: Callable[[], bool]) -> None:
        while not true():
            await self.pass_time(WRITE_INTERVAL_S)

    def stored(self) -> list[int]:
        with Reader(self.path) as reader:
            return [one.sequence for one in reader.measurements_after(0, 5000)]


async def test_every_measurement_is_recorded_once(tmp_path: Path) -> None:
    async with Recording(tmp_path) as recording:
        await recording.pass_time(10.0, rate=20)
    assert recording.stored() == list(range(1, 201))
    with Reader(recording.path) as reader:
        assert sum(row.n for row in reader.summaries(SECONDS, 0, 2**62)) == 200


async def test_seconds_in_which_nothing_is_measured_have_a_row_that_says_why(tmp_path: Path) -> None:
    async with Recording(tmp_path) as recording:
        recording.record(measurement(1, recording.clock.now_ns))
        await recording.pass_time(10.0)
    with Reader(recording.path) as reader:
        rows = list(reader.summaries(SECONDS, 0, 2**62))
    assert [row.t_us // US for row in rows] == list(range(rows[0].t_us // US, rows[0].t_us // US + len(rows)))
    assert len(rows) >= 9
    assert {(row.n, row.worst, row.worst_code) for row in rows[5:]} == {(0, 4, "stale")}


async def test_the_end_writes_what_waits(tmp_path: Path) -> None:
    async with Recording(tmp_path) as recording:
        await recording.until(lambda: recording.component.state is State.OK)
        recording.publish()
        recording.log.note(EventKind.STOPPED, "the last word")
    assert recording.stored()[-1] == recording.published
    with Reader(recording.path) as reader:
        assert reader.events(0, 2**62)[0].text == "the last word"


async def test_a_clock_that_is_set_is_an_event_and_begins_an_epoch(tmp_path: Path) -> None:
    async with Recording(tmp_path) as recording:
        await recording.pass_time(2.0, rate=20)
        recording.clock.offset_s = -START_S + 5.0  # 1970
        await recording.pass_time(2.0, rate=20)
        recording.clock.offset_s = 0.0
        await recording.pass_time(2.0, rate=20)
    assert recording.stored() == list(range(1, 121))
    with Reader(recording.path) as reader:
        assert [one.epoch for one in reader.measurements_after(0, 500)] == [1] * 40 + [2] * 40 + [3] * 40
        told = [event.text for event in reader.events(0, 2**62, ["clock"])]
    assert len(told) == 2
    assert all(text.startswith("the time of day was set by ") for text in told)


async def test_events_that_are_lost_while_the_disk_is_full_are_counted_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_log, "MAX_EVENTS", 5)
    monkeypatch.setattr(event_log, "MAX_REQUEST_EVENTS", 2)
    async with Recording(tmp_path) as recording:
        await recording.until(lambda: recording.component.state is State.OK)
        with monkeypatch.context() as full:
            full.setattr(Store, "write", refuse)
            for number in range(10):
                for kind in (EventKind.REQUEST, EventKind.STATE):
                    recording.log.note(kind, f"{number}", f"{number}")
            await recording.until(lambda: recording.component.state is State.DEGRADED)
            await recording.pass_time(60.0)
        await recording.until(lambda: recording.component.state is State.OK)
        assert recording.component.counters["events_lost"] == 13
    with Reader(recording.path) as reader:
        stored = [one.text for one in reader.events(0, 2**62, ["request", "state"])]
    assert stored == ["9", "9", "8", "8", "7", "6", "5"]


def refuse(*_: object) -> Written:
    raise OSError(28, "No space left on device")


async def test_what_a_full_disk_refuses_is_let_go_without_the_garbage_collector(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Store, "write", refuse)
    async with Recording(tmp_path) as recording:
        gc.collect()
        gc.disable()
        try:
            await recording.pass_time(60.0, rate=5)
            held = [each for each in gc.get_objects() if isinstance(each, Batch)]
        finally:
            gc.enable()
        assert recording.component.state is State.DEGRADED
        assert len(held) <= 1, "that which is under way"


async def test_a_disk_that_goes_and_comes_back_costs_history_only(tmp_path: Path) -> None:
    folder = tmp_path / "disk"
    folder.mkdir()
    async with Recording(folder) as recording:
        await recording.until(lambda: recording.component.state is State.OK)
        shutil.rmtree(folder)
        await recording.until(lambda: recording.component.state is State.DEGRADED)
        await recording.pass_time(3.0, rate=20)
        assert "not written" in recording.component.message
        folder.mkdir()
        await recording.until(lambda: recording.component.state is State.OK)
        lost = recording.component.counters.get("measurements_lost", 0)
    assert recording.stored() == list(range(1, 61))
    assert lost == 0


def fail_after_commit(patches: pytest.MonkeyPatch, step: str, times: int) -> list[str]:
    """Let a step that follows each COMMIT fail as on a full disk; returns the list of failures."""
    failed: list[str] = []

    def fail() -> None:
        if len(failed) < times:
            failed.append(step)
            raise sqlite3.OperationalError("database or disk is full")

    place: Any = Retention if step in ("shrink", "used_bytes") else open_store.OpenStore
    if step in ("touched", "COMMIT"):
        place = open_store if step == "touched" else opening.transaction
    name = "__exit__" if step == "COMMIT" else step
    original = getattr(place, name)

    def with_fault(self: Any, *arguments: Any) -> Any:
        if step == "COMMIT":
            original(self, *arguments)
        if step == "touched":
            is_after = sys._getframe(1).f_code.co_name != "_check_place"  # noqa: SLF001
        else:
            is_after = not self._connection.in_transaction
        if is_after:
            fail()
        return None if step == "COMMIT" else original(self, *arguments)

    patches.setattr(place, name, with_fault)
    return failed


@pytest.mark.parametrize("step", ["shrink", "used_bytes", "_outbox_mark", "touched", "COMMIT"])
async def test_what_fails_after_a_commit_writes_nothing_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    store = Store(tmp_path / "history.db", MAX_BYTES, ABOUT, has_outbox=True)
    async with Recording(tmp_path, store) as recording:
        await recording.until(lambda: recording.component.state is State.OK)
        recording.log.note(EventKind.STATE, "once")
        failed = fail_after_commit(monkeypatch, step, 4)
        await recording.pass_time(2.0, rate=20)
        assert recording.component.state is State.DEGRADED
        assert "disk is full" in recording.component.message or step == "touched"
        await recording.pass_time(4.0, rate=20)
        await recording.until(lambda: len(failed) == 4)
        await recording.until(lambda: recording.component.state is State.OK)
    assert recording.stored() == list(range(1, 121))
    with Reader(recording.path) as reader:
        rows = list(reader.summaries(SECONDS, 0, 2**62))
        assert len(reader.events(0, 2**62, ["state"])) == 1
        (epochs,) = next(iter(reader.rows("SELECT max(epoch) FROM epochs")))
        (queued,) = next(iter(reader.rows("SELECT count(*) FROM outbox")))
    assert sum(row.n for row in rows) == 120
    assert queued == len(rows)
    if step not in ("touched", "COMMIT"):
        assert (epochs, len(rows)) == (1, len({row.t_us for row in rows}))


class HeldStore(Store):
    """A disk that takes as long as the test wants: no file system of this machine can be made to.

    It waits where SQLite would wait for the disk: between the batch and the file.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.clock: WallClock | None = None
        self.may_go: threading.Event | None = None
        self.is_held = False

    def write(self, batch: Batch) -> Written:
        if self.may_go is not None and self.clock is not None:
            self.is_held = True
            self.clock.hold(self.may_go)
            self.is_held = False
        return super().write(batch)

    def hold(self) -> None:
        self.may_go = threading.Event()

    def let_go(self) -> None:
        if self.may_go is not None and self.clock is not None:
            self.clock.release(self.may_go)
            self.may_go = None


@contextmanager
def held(store: HeldStore) -> Iterator[None]:
    store.hold()
    try:
        yield
    finally:
        store.let_go()


async def test_a_disk_that_takes_ten_seconds_loses_nothing_and_is_told(tmp_path: Path) -> None:
    slow = HeldStore(tmp_path / "history.db", MAX_BYTES, ABOUT)
    async with Recording(tmp_path, slow) as recording:
        await recording.until(lambda: recording.component.state is State.OK)
        with held(slow):
            await recording.pass_time(10.0, rate=20)
            assert recording.component.state is State.DEGRADED
            assert "the disk has not answered for" in recording.component.message
        await recording.until(lambda: recording.component.state is State.OK)
        assert "measurements_lost" not in recording.component.counters
    assert recording.stored() == list(range(1, 201))


async def test_a_disk_that_hangs_costs_a_bounded_number_which_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "MAX_WAITING_ITEMS", 100)
    slow = HeldStore(tmp_path / "history.db", MAX_BYTES, ABOUT)
    async with Recording(tmp_path, slow) as recording:
        await recording.until(lambda: recording.component.state is State.OK)
        with held(slow):
            await recording.pass_time(20.0, rate=20)
        await recording.until(lambda: recording.component.state is State.OK)
        lost = recording.component.counters["measurements_lost"]
    stored = recording.stored()
    assert 200 < lost < 400
    assert len(stored) == 400 - lost
    assert stored[-1] == 400


async def test_what_is_dropped_does_not_take_the_setting_of_the_clock_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "MAX_WAITING_ITEMS", 50)
    slow = HeldStore(tmp_path / "history.db", MAX_BYTES, ABOUT)
    async with Recording(tmp_path, slow) as recording:
        await recording.pass_time(2.0, rate=20)
        await recording.until(lambda: recording.component.state is State.OK)
        with held(slow):
            await recording.pass_time(WRITE_INTERVAL_S, rate=20)
            recording.clock.offset_s = -3600.0
            await recording.pass_time(10.0, rate=20)
        await recording.until(lambda: recording.component.state is State.OK)
        await recording.pass_time(2.0)
    with Reader(recording.path) as reader:
        stored = reader.measurements_after(0, 5000)
    assert {one.epoch for one in stored[-40:]} == {2}
    assert all(one.t_us < START_S * US for one in stored[-40:])


async def test_the_end_does_not_wait_for_a_disk_that_hangs(tmp_path: Path) -> None:
    slow = HeldStore(tmp_path / "history.db", MAX_BYTES, ABOUT)
    recording = Recording(tmp_path, slow, end_within_s=1.0)
    async with recording:
        await recording.until(lambda: recording.component.state is State.OK)
        slow.hold()
        await recording.pass_time(2.0, rate=20)
    assert slow.is_held
    slow.let_go()


async def test_a_defect_of_the_history_ends_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> Written:
        raise KeyError("a defect")

    async with Recording(tmp_path) as recording:
        monkeypatch.setattr(Store, "write", fail)
        await recording.until(lambda: recording.component.message == "a defect: KeyError: 'a defect'")
        assert recording.component.state is State.DEGRADED
        recording.component.counters.clear()
        recording.log.note(EventKind.STATE, "lost with the batch")
        await recording.pass_time(2.0, rate=20)
        lost = recording.component.counters
        await recording.until(lambda: lost.get("measurements_lost") == recording.published)
        assert lost["events_lost"] == 1
        recording.publish()
