"""The history of the time before a start is read, at the start and when the clock was set."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest
from support.history import ABOUT, MAX_BYTES, WallClock, record_seconds

from altd.app.keeping import CHECK_INTERVAL_S, DaemonHistory, PastAvailability
from altd.history.history import History, NoHistoryError
from altd.history.opening import WriteLock
from altd.history.records import About
from altd.instruments.beam.instrument import QUANTITIES
from altd.status.availability import Availability
from altd.status.board import Board
from altd.status.health import Health
from altd.status.models import status_of
from altd.status.state import UnitState
from altd.status.unit import PublishedUnit

START_NS = 10**12


class Restarted:
    """A unit that starts at START_NS of its clock, with what a history holds of the time before."""

    def __init__(self, folder: Path) -> None:
        self.clock = WallClock(START_NS)
        self.folder = folder
        self.path = folder / "history.db"
        self.history = History(self.path)
        self.availability = Availability(START_NS, self.clock.utc)

    @property
    def start_s(self) -> int:
        return int(self.clock.utc(START_NS).timestamp())

    def ran_before(self, from_s: int, seconds: int) -> None:
        record_seconds(self.folder, from_s, [10.0] * seconds, rate=2)

    def hour(self) -> dict[str, Any]:
        return self.availability.spans()["last_hour"].as_object()

    async def until(self, true: Callable[[], bool]) -> None:
        async with asyncio.timeout(60):
            while not true():
                await self.clock.advance(CHECK_INTERVAL_S)
                await asyncio.sleep(0.01)  # the disk's thread, in real time


@contextlib.asynccontextmanager
async def reading(unit: Restarted) -> AsyncIterator[Restarted]:
    task = asyncio.create_task(PastAvailability(unit.history, unit.availability, unit.clock).run())
    try:
        yield unit
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await unit.history.end()


def daemon_of(unit: Restarted, about: About) -> tuple[PublishedUnit, UnitState, DaemonHistory]:
    """The data that a daemon, as ``about`` says, keeps in the unit's history."""
    health = Health(unit.clock)
    board = Board(unit.clock, 1.0, QUANTITIES)
    state = UnitState(board, health, unit.clock)
    published = PublishedUnit(board, health, state=state.read)
    past = DaemonHistory(published, state)
    past.keep_in(unit.path, MAX_BYTES, about)
    return published, state, past


async def test_a_restart_loses_nothing_of_the_hour(tmp_path: Path) -> None:
    unit = Restarted(tmp_path)
    unit.ran_before(unit.start_s - 120, 60)
    async with reading(unit):
        await unit.until(lambda: unit.hour()["observed_s"] > 0)
    shown = unit.hour()
    assert shown["valid_s"] == pytest.approx(60, abs=1)
    assert shown["lost_s"] == pytest.approx({"not_running": 60}, abs=1)
    assert shown["share"] == pytest.approx(0.5, abs=0.01)


async def test_a_history_that_cannot_be_read_leaves_what_is_known_since_the_start(tmp_path: Path) -> None:
    unit = Restarted(tmp_path)
    unit.path.write_bytes(b"no history at all, but so long that it is looked at" * 100)
    async with reading(unit):
        for _ in range(20):
            await unit.clock.advance(CHECK_INTERVAL_S)
            unit.availability.update(unit.clock.now_ns, None)
            await asyncio.sleep(0.005)
        assert unit.hour()["observed_s"] == 100.0
        assert unit.hour()["since"] == "2026-11-20T08:16:40.000Z", "the start: nothing before it is known"


async def test_one_that_can_be_read_later_is_read_then(tmp_path: Path) -> None:
    unit = Restarted(tmp_path)
    async with reading(unit):
        for _ in range(5):
            await unit.clock.advance(CHECK_INTERVAL_S)
            await asyncio.sleep(0.005)
        unit.ran_before(unit.start_s - 60, 60)
        await unit.until(lambda: unit.hour()["valid_s"] > 0)
    assert unit.hour()["valid_s"] == pytest.approx(60, abs=1)


async def test_a_clock_that_is_set_after_the_start_puts_the_past_in_its_place(tmp_path: Path) -> None:
    """A unit without a battery: until a time server sets its clock, it knows of no time before its start."""
    unit = Restarted(tmp_path)
    unit.ran_before(unit.start_s - 60, 60)
    unit.clock.offset_s = -1e9
    async with reading(unit):
        for _ in range(20):
            await unit.clock.advance(CHECK_INTERVAL_S)
            await asyncio.sleep(0.005)
        assert unit.hour()["observed_s"] == 0.0
        unit.clock.offset_s = 0.0
        await unit.until(lambda: unit.hour()["valid_s"] > 0)
    assert unit.hour()["valid_s"] == pytest.approx(60, abs=1)


async def test_a_daemon_counts_what_its_history_holds(tmp_path: Path) -> None:
    unit = Restarted(tmp_path)
    unit.ran_before(unit.start_s - 120, 60)
    published, _, past = daemon_of(unit, ABOUT)
    hour: dict[str, Any] = {}
    async with past.recorded():
        async with asyncio.timeout(60):
            while not hour.get("valid_s"):
                await unit.clock.advance(CHECK_INTERVAL_S)
                await asyncio.sleep(0.01)  # the disk's thread, in real time
                hour = status_of(published.view()).as_object()["availability"]["last_hour"]
    assert hour["valid_s"] == pytest.approx(60, abs=1)
    assert hour["lost_s"]["not_running"] == pytest.approx(60, abs=1)


async def test_a_daemon_takes_nothing_from_a_history_of_another_unit(tmp_path: Path) -> None:
    """It lies in this unit's place until it is moved aside, and while the other one's daemon writes it."""
    unit = Restarted(tmp_path)
    unit.ran_before(unit.start_s - 120, 60)
    _, state, past = daemon_of(unit, About(ABOUT.columns, {"serial": "TEST-2"}))
    lock = WriteLock(unit.path)
    async with past.recorded():
        with pytest.raises(NoHistoryError, match="is of unit 'TEST-1', and this one is 'TEST-2'"):
            await past.history.ask(lambda reader: reader.trend(0, 2**61, 10))
        for _ in range(20):
            await unit.clock.advance(CHECK_INTERVAL_S)
            await asyncio.sleep(0.005)
        assert state.availability.before.known_s == 0.0
        lock.release()
