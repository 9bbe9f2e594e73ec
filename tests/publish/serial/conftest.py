"""A clock that a test moves, a board, and the two ends of a serial line."""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pytest

from altd.config import SerialPort
from altd.records import Beam, Measurement
from altd.service.health import Component, Health


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
