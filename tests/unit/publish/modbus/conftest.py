"""A board with measurements on it, and a publisher that serves it for the length of a test."""

import contextlib
import os
from collections.abc import AsyncIterator, Iterator
from datetime import UTC, datetime
from typing import Any

import pytest
from support.clock import FakeClock
from support.measurements import measured
from support.modbus_wire import UNIT, Client, Measured, connected
from support.serving import serving

from altd.config import ModbusTcpSettings
from altd.instruments.beam.solver import Beam
from altd.publish.modbus.tcp import ModbusTcpPublisher
from altd.records import Measurement
from altd.status.board import Board
from altd.status.health import Component, Health
from altd.status.unit import PublishedUnit


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock(50_000_000_000)


@pytest.fixture
def component(clock: FakeClock) -> Component:
    return Component("modbus", clock)


@pytest.fixture(name="measured")
def measured_fixture(clock: FakeClock) -> Measured:
    """Makes a valid measurement whose exposures lie 520 ms back; keywords replace its fields."""

    def measurement(**fields: Any) -> Measurement:
        ordinary: dict[str, Any] = {
            "t_ns": clock.now_ns - 520_000_000,
            "time": datetime(2026, 11, 20, 8, 15, 30, 125_000, tzinfo=UTC),
            "beam": Beam(
                10.012, 4.987, 1.1459, -1.7184, 0.004, 0.005, 0.0011, 0.0012, (0.003, 0.0045, 0.0009, 0.001)
            ),
        }
        return measured(**(ordinary | fields))

    return measurement


@pytest.fixture
def published(board: Board, component: Component) -> PublishedUnit:
    """A unit without facts."""
    return PublishedUnit(board, Health(component.clock))


def tcp_of(unit: PublishedUnit, component: Component, **more: Any) -> ModbusTcpPublisher:
    """A Modbus TCP publisher on a free port of the loopback, with these settings."""
    settings = ModbusTcpSettings(**{"host": "127.0.0.1", "port": 0, "unit_id": UNIT, **more})
    return ModbusTcpPublisher(settings, unit, component)


@pytest.fixture
async def tcp(published: PublishedUnit, component: Component) -> AsyncIterator[ModbusTcpPublisher]:
    publisher = tcp_of(published, component)
    async with serving(publisher):
        yield publisher


@pytest.fixture
async def client(tcp: ModbusTcpPublisher) -> AsyncIterator[Client]:
    async with connected(tcp) as client:
        yield client


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    """A pseudo terminal: the controller's end as a descriptor, the unit's end as a device."""
    controller, unit = os.openpty()
    os.set_blocking(controller, False)
    try:
        yield controller, os.ttyname(unit)
    finally:
        os.close(unit)
        with contextlib.suppress(OSError):
            os.close(controller)
