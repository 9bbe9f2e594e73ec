"""The operating hours of a unit: over restarts, power cuts, a second daemon, and with a broken file."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import datetime
from pathlib import Path

import pytest
from support.clock import FakeClock

from altd.app.operating_time import SAVE_INTERVAL_S, OperatingTime, file_in, read_seconds
from altd.status.health import Health, State

HOUR_S = 3600.0


class NoTimeOfDay(FakeClock):
    """One that is set wherever it is read."""

    def utc(self, t_ns: int) -> datetime:
        raise AssertionError("the time of day does not count")


@asynccontextmanager
async def counting(path: Path, clock: FakeClock) -> AsyncIterator[OperatingTime]:
    """A daemon that counts."""
    operated = OperatingTime(path, Health(clock).component("operating time"))
    task = asyncio.create_task(operated.run())
    await clock.settle()
    yield operated
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return file_in(tmp_path, "TEST-1")


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    monkeypatch.setattr("altd.app.operating_time._DISK_TIMEOUT_S", 60.0)  # the disk of a busy computer
    clock = NoTimeOfDay(5 * 10**12)
    clock.watch_devices()
    return clock


async def test_hours_add_up_over_restarts_and_a_power_cut_loses_minutes(path: Path, clock: FakeClock) -> None:
    async with counting(path, clock) as operated:
        assert operated.hours() == 0.0
        await clock.advance(2 * HOUR_S - 1)
        assert 2 * HOUR_S - 1 - SAVE_INTERVAL_S <= read_seconds(path) <= 2 * HOUR_S - 1
        await clock.advance(1)
    clock.now_ns += 10**15  # the unit is off
    async with counting(path, clock) as operated:
        await clock.advance(HOUR_S / 2)
        assert operated.hours() == pytest.approx(2.5, abs=1e-4)
    assert read_seconds(path) == pytest.approx(2.5 * HOUR_S, abs=0.1)


async def test_two_daemons_at_once_count_an_hour_once(path: Path, clock: FakeClock) -> None:
    async with counting(path, clock):
        await clock.advance(HOUR_S)
        async with counting(path, clock) as second:
            await clock.advance(HOUR_S)
            assert second.hours() == pytest.approx(2.0, abs=0.1)
    assert read_seconds(path) == pytest.approx(2 * HOUR_S, abs=0.1)


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[]", b'{"format": "altd-operating-time/1", "seconds": 1.0, "checksum": "sha256:0"}'],
)
async def test_a_damaged_file_is_not_0_hours_and_is_left_as_it_is(
    path: Path, clock: FakeClock, content: bytes
) -> None:
    path.write_bytes(content)  # noqa: ASYNC240
    async with counting(path, clock) as operated:
        await clock.advance(HOUR_S)
        assert (operated.hours(), operated.component.state) == (None, State.DEGRADED)
        assert operated.component.message.startswith(f"not known: {path}: ")
        assert path.read_bytes() == content  # noqa: ASYNC240
        path.unlink()  # noqa: ASYNC240  the technician's decision
        await clock.advance(SAVE_INTERVAL_S)
        assert operated.hours() == pytest.approx(1.0 + SAVE_INTERVAL_S / HOUR_S, abs=1e-4)
        assert operated.component.state is State.OK


async def test_without_its_folder_the_hours_are_not_known(tmp_path: Path, clock: FakeClock) -> None:
    """As on a disk that is not mounted."""
    async with counting(file_in(tmp_path / "gone", "TEST-1"), clock) as operated:
        assert (operated.hours(), operated.component.state) == (None, State.DEGRADED)


async def test_what_cannot_be_written_counts_on_and_is_reported(path: Path, clock: FakeClock) -> None:
    async with counting(path, clock) as operated:
        path.unlink()  # noqa: ASYNC240
        path.mkdir()  # noqa: ASYNC240  refuses root, too
        await clock.advance(HOUR_S)
        assert operated.hours() == pytest.approx(1.0, abs=1e-4)
        assert operated.component.state is State.DEGRADED
        assert operated.component.message.startswith(f"not kept: {path}: ")
