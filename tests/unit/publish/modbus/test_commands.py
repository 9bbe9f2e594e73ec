"""The one thing that a controller may ask for by a write, on a real socket."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
from support.clock import FakeClock
from support.modbus_wire import UNIT, Client, connected, frame
from support.serving import serving

from altd.config import ModbusTcpSettings
from altd.publish.modbus.tcp import ModbusTcpPublisher
from altd.status.board import Board
from altd.status.health import Component, Health

NOW = bytes.fromhex("06 03e8 0001")


@pytest.fixture
def asked() -> list[bool]:
    return []


@pytest.fixture
def health(asked: list[bool], clock: FakeClock) -> Health:
    health = Health(clock)
    health.self_check.open(lambda: asked.append(True))
    return health


@pytest.fixture(params=[True])
async def controller(
    request: pytest.FixtureRequest, board: Board, component: Component, health: Health
) -> AsyncIterator[Client]:
    settings = ModbusTcpSettings(host="127.0.0.1", port=0, unit_id=UNIT, allow_self_check=request.param)
    publisher = ModbusTcpPublisher(settings, board, component, health)
    async with serving(publisher), connected(publisher) as client:
        yield client


async def test_a_write_asks_for_a_self_check(controller: Client, asked: list[bool]) -> None:
    assert await controller.ask(NOW) == NOW
    assert asked == [True]


@pytest.mark.parametrize("controller", [False], indirect=True)
async def test_without_the_setting_it_is_a_function_that_is_not_served(
    controller: Client, asked: list[bool]
) -> None:
    assert await controller.ask(NOW) == bytes.fromhex("86 01")
    assert asked == []


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("06 0000 0001", "86 02"),
        ("06 03e9 0001", "86 02"),
        ("06 03e8 0000", "86 03"),
        ("06 03e8 0002", "86 03"),
        ("06 03e8 00", "86 03"),
        ("06 03e8 0001 00", "86 03"),
        ("06", "86 03"),
        ("10 03e8 0001 02 0001", "90 01"),
        ("05 03e8 ff00", "85 01"),
        ("06 e803 0100", "86 02"),
        ("06 03e8 0100", "86 03"),
        ("06 03e8 ffff", "86 03"),
        ("06 ffff 0001", "86 02"),
        ("06 03e8 0001 06 03e8 0001", "86 03"),
        ("10 03e8 007b f6" + " 0001" * 123, "90 01"),
        ("0f 03e8 0001 01 01", "8f 01"),
        ("16 03e8 0000 0001", "96 01"),
        ("17 0000 0001 03e8 0001 02 0001", "97 01"),
        ("08 0001 ff00", "88 01"),
        ("86 03e8 0001", "86 01"),
        ("03 03e8 0001", "83 02"),
        ("04 03e8 0001", "84 02"),
    ],
)
async def test_nothing_else_is_taken(
    controller: Client, asked: list[bool], request_hex: str, answer_hex: str
) -> None:
    assert (await controller.ask(bytes.fromhex(request_hex))).hex() == answer_hex.replace(" ", "")
    assert asked == []


async def test_a_unit_that_cannot_check_itself_is_a_failure_of_the_device(
    controller: Client, health: Health
) -> None:
    health.self_check.unavailable = "the calibration has no LED references"
    assert await controller.ask(NOW) == bytes.fromhex("86 04")


@pytest.mark.parametrize("unit", [0, 255])
async def test_the_ids_of_the_device_itself_are_its_own(
    controller: Client, asked: list[bool], unit: int
) -> None:
    assert await controller.ask(NOW, unit=unit) == NOW
    assert asked == [True]


async def test_a_flood_of_writes_keeps_no_other_controller_waiting(
    board: Board, component: Component, health: Health, asked: list[bool]
) -> None:
    settings = ModbusTcpSettings(host="127.0.0.1", port=0, unit_id=UNIT, allow_self_check=True)
    publisher = ModbusTcpPublisher(settings, board, component, health)
    status = bytes.fromhex("04 0000 0001")
    async with serving(publisher), connected(publisher) as flooding, connected(publisher) as reading:
        for number in range(2000):
            flooding.send(frame(NOW, transaction=number))
        for _ in range(5):
            assert await reading.ask(status) == bytes.fromhex("04 02 0002")  # nothing was measured yet
        assert len(asked) < 1000
        for number in range(2000):
            assert await flooding.hear() == (number, UNIT, NOW)
    assert len(asked) == 2000  # each is answered; the schedule makes one check of them


async def test_another_unit_is_not_asked(controller: Client, asked: list[bool]) -> None:
    assert await controller.ask(NOW, unit=9) == bytes.fromhex("86 0b")
    assert asked == []
