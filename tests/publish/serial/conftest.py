"""A clock that a test moves, a board, and the two ends of a serial line."""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from altd.config import SerialPort
from altd.records import Beam, Measurement
from altd.service.board import Board
from altd.service.health import Component, Health

START = datetime(2026, 11, 20, 8, 15, 22, 125_000, UTC)


class TestClock:
    __test__ = False

    def __init__(self) -> None:
        self.now_ns = 8_000_000_000
        self._sleepers: list[tuple[int, asyncio.Future[None]]] = []

    def monotonic_ns(self) -> int:
        return self.now_ns

    def utc(self, t_ns: int) -> datetime | None:
        return START + timedelta(microseconds=t_ns / 1000)

    async def sleep(self, seconds: float) -> None:
        future = asyncio.get_running_loop().create_future()
        self._sleepers.append((self.now_ns + round(seconds * 1e9), future))
        await future

    async def advance(self, seconds: float) -> None:
        """Let time pass once the code under test sleeps, and let it do what was due."""
        await settle()
        self.now_ns += round(seconds * 1e9)
        due = [future for t_ns, future in self._sleepers if t_ns <= self.now_ns]
        self._sleepers = [(t_ns, future) for t_ns, future in self._sleepers if t_ns > self.now_ns]
        for future in due:
            if not future.done():
                future.set_result(None)
        await settle()


async def settle() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


@dataclass
class Wire:
    """The far end of a pseudo terminal, and the device that the unit opens."""

    far: int
    near: int
    device: Path

    def settings(self, **changes: object) -> SerialPort:
        values: dict[str, object] = {"device": self.device, "speaks": "telegram", **changes}
        return SerialPort.model_validate(values)

    def send(self, data: bytes) -> None:
        os.write(self.far, data)

    async def receive(self, enough: Callable[[bytes], bool], timeout_s: float = 3.0) -> bytes:
        """What the unit sent, up to when it is enough."""
        data = b""
        async with asyncio.timeout(timeout_s):
            while not enough(data):
                try:
                    data += os.read(self.far, 4096)
                except BlockingIOError:
                    await asyncio.sleep(0.002)
        return data

    def hang_up(self) -> None:
        for descriptor in (self.near, self.far):
            if descriptor >= 0:
                os.close(descriptor)
        self.near = self.far = -1


@pytest.fixture
def wire() -> Iterator[Wire]:
    far, near = os.openpty()
    os.set_blocking(far, False)
    tty.setraw(near)
    wire = Wire(far, near, Path(os.ttyname(near)))
    yield wire
    wire.hang_up()


@pytest.fixture
def clock() -> TestClock:
    return TestClock()


@pytest.fixture
def board(clock: TestClock) -> Board:
    return Board(clock, stale_after_s=1.0)


@pytest.fixture
def health(clock: TestClock) -> Health:
    health = Health(clock)
    health.facts |= {"version": "0.1.0", "serial": "ALT-0007", "calibration": "2026-11-02"}
    return health


@pytest.fixture
def component(health: Health) -> Component:
    return health.component("serial")


@pytest.fixture
def measured() -> Measurement:
    return Measurement(
        sequence=160,
        t_ns=8_000_000_000,
        time=datetime(2026, 11, 20, 8, 15, 30, 125_999, UTC),
        frames=20,
        beam=Beam(10.012, -4.987, 1.1459, -1.7184, 0.004, 0.0041, 0.0011, 0.0012),
        points_mm={"front": (10.012, -4.987), "rear": (15.613, -3.413)},
    )
