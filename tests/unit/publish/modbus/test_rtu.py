"""Modbus RTU over a pseudo terminal: alone, on a shared bus, and through noise."""

import asyncio
import contextlib
import os
import struct
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from support.modbus_rtu_wire import COLLIDING, READ_OF_20, crc, frame
from support.modbus_wire import ONE, ONE_ANSWER, UNIT
from support.serving import serving

from altd.config import ModbusRtuPortSettings
from altd.publish.modbus import rtu
from altd.publish.modbus.registers import SIZE
from altd.publish.modbus.rtu import MAX_UNCLEAR_LOOPBACKS, ModbusRtuPublisher, silence_s
from altd.status.board import Board
from altd.status.health import Component, Health
from altd.status.unit import PublishedUnit


class Controller:
    """The other end of the line."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def send(self, data: bytes) -> None:
        assert os.write(self._descriptor, data) == len(data)

    async def hear(self, count: int, within_s: float = 60.0) -> bytes:
        """Up to ``count`` bytes; fewer when the time is over.

        A turn of the loop counts as a millisecond: the unit has its turns, even if the process stood still.
        """
        heard = b""
        for _ in range(round(1000 * within_s)):
            with contextlib.suppress(BlockingIOError):
                heard += os.read(self._descriptor, count - len(heard))
            if len(heard) == count:
                break
            await asyncio.sleep(0.001)
        return heard

    async def ask(self, pdu: bytes, answer_length: int) -> bytes:
        self.send(frame(pdu))
        return await self.hear(answer_length)

    async def answer(self) -> bytes:
        """All of an answer: until there is silence."""
        return await self.hear(1) + await self.hear(255, within_s=0.05)

    async def is_answered(self) -> bool:
        expected = frame(ONE_ANSWER)
        return await self.ask(ONE, len(expected)) == expected

    async def hears_nothing(self) -> bool:
        return await self.hear(1, within_s=0.03) == b""


def rtu_at(device: str, published: PublishedUnit, component: Component, **fields: Any) -> ModbusRtuPublisher:
    ordinary: dict[str, Any] = {"speaks": "modbus_rtu", "baud": 115200, "unit_id": UNIT}
    settings = ModbusRtuPortSettings(device=Path(device), **(ordinary | fields))
    return ModbusRtuPublisher(settings, published, component)


@pytest.fixture
async def controller(pty: tuple[int, str], board: Board, component: Component) -> AsyncIterator[Controller]:
    descriptor, device = pty
    async with serving(rtu_at(device, PublishedUnit(board, Health(component.clock)), component)):
        yield Controller(descriptor)


async def test_everything_is_read_in_one_request(controller: Controller) -> None:
    answer = await controller.ask(struct.pack(">BHH", 3, 0, SIZE), 5 + 2 * SIZE)
    assert answer[:3] == bytes([UNIT, 3, 2 * SIZE])
    assert crc(answer[:-2]) == answer[-2:]
    assert struct.unpack_from(">f", answer, 3 + 200)[0] == pytest.approx(123.456)


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("04 0000 007e", "84 03"),
        ("03 0078 0001", "83 02"),
        ("06 0000 1234", "86 01"),
    ],
)
async def test_what_cannot_be_answered_gets_the_exception_that_says_why(
    controller: Controller, component: Component, request_hex: str, answer_hex: str
) -> None:
    assert await controller.ask(bytes.fromhex(request_hex), 5) == frame(bytes.fromhex(answer_hex))
    assert component.counters == {"requests": 1, "exceptions": 1}


@pytest.mark.parametrize(
    "noise", ["ff", "00", "07", "ff00", "ff0013", "07040000", "0704000000020909", "0c033c0102"]
)
@pytest.mark.parametrize("pause_s", [0.0, 0.01])
async def test_a_request_after_stray_bytes_is_answered(
    controller: Controller, noise: str, pause_s: float
) -> None:
    controller.send(bytes.fromhex(noise))
    await asyncio.sleep(pause_s)
    assert await controller.is_answered()
    assert await controller.is_answered()


async def test_a_request_in_pieces_is_answered_once_and_a_torn_one_never(
    controller: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    request = frame(ONE)
    controller.send(request[:3])
    with monkeypatch.context() as patched:
        patched.setattr(rtu, "FRAGMENT_TIMEOUT_S", 60.0)  # a busy machine is late with the rest
        await asyncio.sleep(0.01)
        controller.send(request[3:])
        assert await controller.hear(9) == frame(ONE_ANSWER)
    monkeypatch.setattr(rtu, "FRAGMENT_TIMEOUT_S", 0.0)
    controller.send(request[:3])
    await asyncio.sleep(0.15)
    controller.send(request[3:])
    assert await controller.hears_nothing()
    assert await controller.is_answered()


async def test_a_frame_with_a_wrong_crc_is_not_answered(controller: Controller, component: Component) -> None:
    request = frame(ONE)
    for place in range(len(request)):
        broken = bytearray(request)
        broken[place] ^= 0x10
        controller.send(bytes(broken))
        await asyncio.sleep(0.005)
    assert await controller.hears_nothing()
    assert component.counters == {}
    assert await controller.is_answered()


@pytest.mark.parametrize(
    "frame_hex",
    [
        "04 0000 0002",
        "04 04 12345678",
        "03 02 1234",
        "84 02",
        "06 0000 1234",
        "10 0000 0001",
        "08 0000 a5a5",
        "11",
        "2b 0e 01 00",
    ],
)
@pytest.mark.parametrize("unit", [0, 1, 9, 247])
async def test_what_others_say_on_the_bus_is_none_of_our_business(
    controller: Controller, component: Component, unit: int, frame_hex: str
) -> None:
    controller.send(frame(bytes.fromhex(frame_hex), unit=unit))
    assert await controller.hears_nothing()
    assert component.counters == {}
    assert await controller.is_answered()


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine is late with the rest of a frame, with an answer and with an echo."""
    monkeypatch.setattr(rtu, "FRAGMENT_TIMEOUT_S", 60.0)
    monkeypatch.setattr(rtu, "RESPONSE_TIMEOUT_S", 60.0)


@pytest.mark.usefixtures("patient")
async def test_the_end_of_anothers_answer_is_no_request(controller: Controller, component: Component) -> None:
    for torn_at in (len(COLLIDING), len(COLLIDING) - 8, 40, 62 % len(COLLIDING)):
        controller.send(READ_OF_20)
        await asyncio.sleep(0.01)
        controller.send(COLLIDING[:torn_at])
        await asyncio.sleep(0.01)
        controller.send(COLLIDING[torn_at:])
        assert await controller.hears_nothing()
    assert component.counters == {}
    assert await controller.is_answered()


@pytest.mark.usefixtures("patient")
async def test_the_echo_of_our_answer_in_pieces_is_not_answered(controller: Controller) -> None:
    controller.send(frame(ONE))
    answer = await controller.answer()
    controller.send(answer[:5])
    await asyncio.sleep(0.01)
    controller.send(answer[5:])
    assert await controller.hears_nothing()
    assert await controller.is_answered()


LOOPBACK = frame(bytes.fromhex("08 0000 1234"))


async def loopbacks_answered(controller: Controller, count: int) -> int:
    """The answers to loopbacks, each sent when the answer before it has come or is overdue."""
    answered = 0
    for _ in range(count):
        controller.send(LOOPBACK)
        answered += await controller.hear(len(LOOPBACK), within_s=5.0) == LOOPBACK
    return answered


async def test_loopbacks_without_a_pause_are_all_answered(controller: Controller) -> None:
    assert await loopbacks_answered(controller, 8) == 8
    assert await controller.is_answered()
    assert await loopbacks_answered(controller, 100) == 100


@pytest.mark.usefixtures("patient")
async def test_one_of_many_loopbacks_on_an_unknown_line_is_answered_busy(controller: Controller) -> None:
    assert await loopbacks_answered(controller, MAX_UNCLEAR_LOOPBACKS) == MAX_UNCLEAR_LOOPBACKS
    controller.send(LOOPBACK)
    assert await controller.answer() == frame(bytes([0x88, 6]))
    assert await loopbacks_answered(controller, 50) == 50


async def heard_with_echo(controller: Controller, request: bytes, expected: bytes) -> bytes:
    """All that the unit sends after a request, if the line returns each of its answers at once.

    A busy machine may be late with what is expected; more than that has to come soon to be heard.
    """
    controller.send(request)
    heard = b""
    while answer := await controller.hear(1, within_s=60.0 if len(heard) < len(expected) else 0.1):
        answer += await controller.hear(255, within_s=0.02)
        heard += answer
        controller.send(answer)
    return heard


@pytest.mark.usefixtures("patient")
async def test_a_line_that_echoes_is_found_out(controller: Controller) -> None:
    for _ in range(2):
        assert await heard_with_echo(controller, frame(ONE), frame(ONE_ANSWER)) == frame(ONE_ANSWER)
        assert await heard_with_echo(controller, LOOPBACK, LOOPBACK) == LOOPBACK


@pytest.mark.usefixtures("patient")
async def test_an_unknown_line_that_echoes_a_loopback_falls_silent(controller: Controller) -> None:
    all_of_it = LOOPBACK * MAX_UNCLEAR_LOOPBACKS + frame(bytes([0x88, 6]))
    assert await heard_with_echo(controller, LOOPBACK, all_of_it) == all_of_it
    assert await heard_with_echo(controller, LOOPBACK, LOOPBACK) == LOOPBACK


@pytest.mark.usefixtures("patient")
async def test_a_line_that_no_longer_echoes_is_found_out(controller: Controller) -> None:
    assert await heard_with_echo(controller, frame(ONE), frame(ONE_ANSWER)) == frame(ONE_ANSWER)
    assert await controller.is_answered()
    assert await controller.is_answered()
    assert await loopbacks_answered(controller, 50) == 50


@pytest.mark.usefixtures("patient")
async def test_a_damaged_echo_is_no_sign_of_a_line_without_echo(controller: Controller) -> None:
    assert await heard_with_echo(controller, frame(ONE), frame(ONE_ANSWER)) == frame(ONE_ANSWER)
    assert await controller.is_answered()
    controller.send(b"\x55" * 9)
    assert await controller.hears_nothing()
    assert await heard_with_echo(controller, LOOPBACK, LOOPBACK) == LOOPBACK


@pytest.mark.usefixtures("patient")
async def test_a_command_is_not_executed_again_for_its_echo(
    pty: tuple[int, str], board: Board, published: PublishedUnit, component: Component
) -> None:
    asked = []
    published.self_check.ask = asked.append  # type: ignore[method-assign]
    command = frame(bytes.fromhex("06 03e8 0001"))
    expected = command + frame(bytes([0x86, 6]))
    async with serving(rtu_at(pty[1], published, component, allow_self_check=True)):
        heard = await heard_with_echo(Controller(pty[0]), command, expected)
    assert heard == expected
    assert asked == ["modbus"]


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("request_hex", ["04 0066 0002", "06 0000 1234", "2b 0e 01 00", "08 0000", "11"])
async def test_the_echo_of_our_own_answer_is_not_answered(controller: Controller, request_hex: str) -> None:
    assert await heard_with_echo(controller, frame(ONE), frame(ONE_ANSWER)) == frame(ONE_ANSWER)
    controller.send(frame(bytes.fromhex(request_hex)))
    answer = await controller.answer()
    controller.send(answer)
    assert await controller.hears_nothing()
    assert await controller.is_answered()


async def test_a_request_right_behind_another_units_answer_is_answered(controller: Controller) -> None:
    controller.send(frame(ONE, unit=9) + frame(ONE_ANSWER, unit=9) + frame(ONE))
    assert await controller.hear(9) == frame(ONE_ANSWER)


async def test_a_request_that_the_controller_gave_up_is_not_answered(controller: Controller) -> None:
    controller.send(frame(ONE) + frame(ONE, unit=9))
    assert await controller.hears_nothing()


async def test_a_port_that_goes_away_ends_the_publisher_with_an_os_error(
    board: Board, component: Component
) -> None:
    controller, unit = os.openpty()
    device = os.ttyname(unit)
    ready = asyncio.Event()
    task = asyncio.create_task(
        rtu_at(device, PublishedUnit(board, Health(component.clock)), component).run(ready.set)
    )
    await ready.wait()
    os.close(unit)
    os.close(controller)
    with pytest.raises(OSError, match="the port is gone"):
        async with asyncio.timeout(60):
            await task


async def test_a_controller_that_takes_no_answers_does_not_hold_the_unit_up(
    controller: Controller, component: Component
) -> None:
    requests = 0
    while "answers_dropped" not in component.counters:
        controller.send(frame(struct.pack(">BHH", 4, 0, SIZE)))
        requests += 1
        while component.counters.get("requests", 0) < requests:  # noqa: ASYNC110  a pty, not this clock
            await asyncio.sleep(0.001)
    while not await controller.hears_nothing():
        await controller.hear(100_000, within_s=0.1)
    assert await controller.is_answered()


async def test_after_a_cancellation_nothing_is_left_and_the_port_is_free(
    pty: tuple[int, str], published: PublishedUnit, component: Component
) -> None:
    before = asyncio.all_tasks()
    for _ in range(3):
        async with serving(rtu_at(pty[1], published, component)):
            assert await Controller(pty[0]).is_answered()
        assert asyncio.all_tasks() == before


@pytest.mark.parametrize(("parity", "stop_bits"), [("even", 1), ("odd", 1), ("none", 2)])
async def test_every_setting_of_the_line_can_be_used(
    pty: tuple[int, str], published: PublishedUnit, component: Component, parity: str, stop_bits: int
) -> None:
    async with serving(rtu_at(pty[1], published, component, parity=parity, stop_bits=stop_bits, baud=1200)):
        assert await Controller(pty[0]).is_answered()


def test_the_silence_is_3_5_characters_but_never_shorter_than_1_75_ms() -> None:
    assert silence_s(9600) == pytest.approx(4.01e-3, rel=1e-3)
    assert silence_s(19200) == pytest.approx(2.005e-3, rel=1e-3)
    assert silence_s(115200) == 1.75e-3
