"""A controller's commands by a write, on real sockets and a line."""

import asyncio
import itertools
import math
import random
import struct
from collections.abc import AsyncIterator
from dataclasses import replace

import pytest
from support.clock import FakeClock
from support.measurements import BEAM, changed
from support.modbus_rtu_wire import frame as rtu_frame
from support.modbus_wire import ONE, ONE_ANSWER, UNIT, Client, Measured, connected, frame, words
from support.serving import serving
from support.wire import Wire

from altd.config import ModbusRtuPortSettings
from altd.publish.modbus.responder import RELATIVE
from altd.publish.modbus.rtu import ModbusRtuPublisher
from altd.reasons import Reason
from altd.records import Fault
from altd.status.board import Board
from altd.status.event_log import EventKind
from altd.status.health import Component, Health
from altd.status.unit import PublishedUnit
from altd.status.zero import Zero

from .conftest import tcp_of

NOW = bytes.fromhex("06 03e8 0001")
FIRST = 0x1234
"""The number of the first zero."""
SET_ZERO = struct.pack(">BHH", 6, 1001, FIRST)


@pytest.fixture
def asked() -> list[bool]:
    return []


@pytest.fixture
def published(asked: list[bool], board: Board, health: Health) -> PublishedUnit:
    unit = PublishedUnit(board, health)
    unit.self_check.open(lambda: asked.append(True))
    unit.zero = Zero(health.events, FIRST)
    return unit


@pytest.fixture
async def controller(published: PublishedUnit, component: Component) -> AsyncIterator[Client]:
    publisher = tcp_of(published, component, allow_self_check=True, allow_zero=True)
    async with serving(publisher), connected(publisher) as client:
        yield client


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("06 03e9 0001", "86 03"),
        ("06 03e9 1233", "86 03"),
        ("06 03e9 1235", "86 03"),
        ("06 03e9 3412", "86 03"),
        ("06 03e9 1234 00", "86 03"),
        ("10 03e9 0001 02 1234", "90 01"),
        ("16 03e9 0000 1234", "96 01"),
        ("17 0000 0001 03e9 0001 02 1234", "97 01"),
        ("05 03e9 ff00", "85 01"),
        ("06 03e8 0000", "86 03"),
        ("06 03e8 0002", "86 03"),
        ("06 03e8 00", "86 03"),
        ("06 03e8 0001 00", "86 03"),
        ("06", "86 03"),
        ("10 03e8 0001 02 0001", "90 01"),
        ("05 03e8 ff00", "85 01"),
        ("06 03e8 0100", "86 03"),
        ("06 03e8 ffff", "86 03"),
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
    controller: Client,
    board: Board,
    published: PublishedUnit,
    measured: Measured,
    asked: list[bool],
    request_hex: str,
    answer_hex: str,
) -> None:
    board.publish(measured())
    assert (await controller.ask(bytes.fromhex(request_hex))).hex() == answer_hex.replace(" ", "")
    assert asked == []
    assert published.zero.state.count == 0


async def test_no_function_writes_to_any_other_register(
    controller: Client, board: Board, published: PublishedUnit, measured: Measured, asked: list[bool]
) -> None:
    """Functions 5, 6, 15, 16, 22 and 23 at each named register, its neighbours and the ends of the space."""
    board.publish(measured())
    everything = struct.pack(">BHH", 4, 0, 120)
    before = await controller.ask(everything)
    ends = {edge for first in (0, 200, 300, 400, 500, 1000) for edge in range(first, first + 30)}
    for address in sorted((ends | {279, 280, 349, 459, 529, 999, 0xFFFF}) - {1000, 1001}):
        for body in ("05 {} ff00", "06 {} 1234", "0f {} 0001 01 01", "10 {} 0001 02 1234", "16 {} 0000 1234"):
            pdu = bytes.fromhex(body.format(f"{address:04x}"))
            assert (await controller.ask(pdu))[0] == pdu[0] | 0x80
        pdu = struct.pack(">BHHHHBH", 23, 0, 1, address, 1, 2, FIRST)
        assert await controller.ask(pdu) == bytes.fromhex("97 01")
    assert await controller.ask(everything) == before
    assert (asked, published.zero.state.count) == ([], 0)


async def test_a_unit_that_cannot_check_itself_is_a_failure_of_the_device(
    controller: Client, published: PublishedUnit
) -> None:
    published.self_check.unavailable = "the calibration has no LED references"
    assert await controller.ask(NOW) == bytes.fromhex("86 04")


@pytest.mark.parametrize(("unit", "answer_hex"), [(0, "06 03e8 0001"), (255, "06 03e8 0001"), (9, "86 0b")])
async def test_the_ids_of_the_device_itself_are_its_own(
    controller: Client, asked: list[bool], unit: int, answer_hex: str
) -> None:
    assert await controller.ask(NOW, unit=unit) == bytes.fromhex(answer_hex)
    assert asked == [True] * (unit != 9)


async def test_a_flood_of_writes_keeps_no_other_controller_waiting(
    published: PublishedUnit, component: Component, asked: list[bool]
) -> None:
    publisher = tcp_of(published, component, allow_self_check=True)
    status = bytes.fromhex("04 0000 0001")
    async with serving(publisher), connected(publisher) as flooding, connected(publisher) as reading:
        for number in range(2000):
            flooding.send(frame(NOW, transaction=number))
        for _ in range(5):
            assert await reading.ask(status) == bytes.fromhex("04 02 0002")  # nothing has been measured yet
        assert len(asked) < 1000
        for number in range(2000):
            assert await flooding.hear() == (number, UNIT, NOW)
    assert len(asked) == 2000  # each is answered; the schedule makes one check of them


async def relative(client: Client) -> dict[str, float]:
    """The relative block by the names of its registers; NaN: not known."""
    answer = await client.ask(struct.pack(">BHH", 3, RELATIVE.first, RELATIVE.size))
    found = words(answer)
    values: dict[str, float] = {}
    for row in RELATIVE.rows:
        here = found[row.address - 500 :][: row.type.words]
        raw = struct.pack(f">{len(here)}H", *here)
        number = struct.unpack({"u16": ">H", "u32": ">I", "f32": ">f"}[row.type], raw)[0]
        values[row.name] = math.nan if here == row.type.unknown else number
    return values


VALUES = ("dx", "dy", "dyaw", "dpitch", "sigma_dx", "sigma_dy", "sigma_dyaw", "sigma_dpitch")


async def test_the_zero_is_set_by_its_number_and_moves_no_published_value(
    controller: Client, board: Board, health: Health, measured: Measured, clock: FakeClock
) -> None:
    board.publish(measured(sequence=160))
    empty = await relative(controller)
    assert (empty["zeros"], empty["next_zero"]) == (0, FIRST)
    assert all(math.isnan(empty[name]) for name in (*VALUES, "zero_sequence", "zero_age"))
    absolute = await controller.ask(struct.pack(">BHH", 4, 20, 60))
    assert await controller.ask(SET_ZERO) == SET_ZERO
    assert await controller.ask(struct.pack(">BHH", 4, 20, 60)) == absolute
    clock.now_ns += 10_000_000_000
    second = changed(measured(sequence=360), replace(BEAM, x_mm=12.512, yaw_deg=1.2459))
    board.publish(second)
    found = await relative(controller)
    assert (found["zeros"], found["next_zero"], found["zero_sequence"]) == (1, FIRST + 1, 160)
    assert (found["sequence"], found["age"], found["zero_age"]) == (360, 520, 11)
    assert found["dx"] == pytest.approx(2.5, abs=1e-6)
    assert found["dyaw"] == pytest.approx(0.1, abs=1e-6)
    assert (found["dy"], found["dpitch"]) == (0, 0)
    assert found["sigma_dx"] == pytest.approx(math.hypot(0.004, 0.004))
    (event,) = [event for event in health.events.after(0) if event.kind is EventKind.REQUEST]
    assert (event.text, event.of) == ("zero 1 was set", "modbus")


async def test_a_write_that_comes_again_sets_nothing(
    controller: Client, board: Board, published: PublishedUnit, measured: Measured
) -> None:
    """Repeated by a gateway, recorded and replayed, or late behind that of another controller."""
    board.publish(measured(sequence=160))
    assert await controller.ask(SET_ZERO) == SET_ZERO
    board.publish(measured(sequence=161))
    for _ in range(3):
        assert await controller.ask(SET_ZERO) == bytes.fromhex("86 03")
    assert published.zero.state.count == 1
    assert published.zero.state.measurement is not None
    assert published.zero.state.measurement.sequence == 160


@pytest.mark.parametrize("why", ["nothing yet", "stale", "invalid", "simulated"])
async def test_without_a_valid_live_measurement_no_zero_is_set_and_nothing_is_relative(
    controller: Client, board: Board, measured: Measured, clock: FakeClock, why: str
) -> None:
    if why != "nothing yet":
        board.publish(measured(sequence=160))
        assert await controller.ask(SET_ZERO) == SET_ZERO
        if why == "stale":
            clock.now_ns += 2_000_000_000
        elif why == "invalid":
            board.publish(measured(beam=None, status=(Fault(Reason.SPOT_MISSING, "front"),)))
        else:
            board.publish(measured(status=(Fault(Reason.SIMULATED),)))
    before = await relative(controller)
    assert before["status"] % 2 == 0
    assert all(math.isnan(before[name]) for name in VALUES)
    again = struct.pack(">BHH", 6, 1001, int(before["next_zero"]))
    assert await controller.ask(again) == bytes.fromhex("86 04")
    after = await relative(controller)
    for name in ("zeros", "next_zero", "zero_sequence"):
        assert after[name] == before[name] or math.isnan(after[name])


async def test_another_daemon_knows_no_zero_of_the_one_before(
    controller: Client, board: Board, clock: FakeClock, measured: Measured
) -> None:
    board.publish(measured())
    assert await controller.ask(SET_ZERO) == SET_ZERO
    restarted = PublishedUnit(board, Health(clock))
    restarted.zero = Zero(restarted.events, (FIRST + 7) % 0xFFFF)
    publisher = tcp_of(restarted, Component("again", clock), allow_zero=True)
    async with serving(publisher), connected(publisher) as client:
        found = await relative(client)
        assert found["zeros"] == 0
        assert all(math.isnan(found[name]) for name in VALUES)
        assert await client.ask(SET_ZERO) == bytes.fromhex("86 03")


async def test_each_command_has_its_own_setting(
    board: Board,
    component: Component,
    health: Health,
    published: PublishedUnit,
    measured: Measured,
    asked: list[bool],
) -> None:
    board.publish(measured())
    for allowed in itertools.product([False, True], repeat=2):
        publisher = tcp_of(published, component, allow_self_check=allowed[0], allow_zero=allowed[1])
        refused = bytes.fromhex("86 02") if any(allowed) else bytes.fromhex("86 01")
        set_zero = struct.pack(">BHH", 6, 1001, published.zero.state.next_number)
        async with serving(publisher), connected(publisher) as client:
            assert await client.ask(NOW) == (NOW if allowed[0] else refused)
            assert await client.ask(set_zero) == (set_zero if allowed[1] else refused)
    assert (len(asked), published.zero.state.count) == (2, 2)


@pytest.mark.parametrize("is_allowed", [True, False])
async def test_on_a_line_only_a_write_to_this_unit_sets_the_zero(
    board: Board,
    component: Component,
    health: Health,
    published: PublishedUnit,
    measured: Measured,
    is_allowed: bool,
) -> None:
    """Not a broadcast (unit id 0), nor one to another unit, nor what another unit answers, nor noise."""
    board.publish(measured())
    wire = Wire.laid()
    settings = ModbusRtuPortSettings(
        device=wire.device, speaks="modbus_rtu", baud=115200, unit_id=UNIT, allow_zero=is_allowed
    )
    rng = random.Random(3)
    try:
        async with serving(ModbusRtuPublisher(settings, published, component)):
            for unit in (0, UNIT + 1, 247):
                wire.send(rtu_frame(SET_ZERO, unit=unit))  # and, of another unit, its answer
                wire.send(rtu_frame(SET_ZERO, unit=unit))
                answer = await asked_on(wire, ONE)
                assert answer == rtu_frame(ONE_ANSWER)
            wire.send(rng.randbytes(7) + rtu_frame(SET_ZERO))  # the end of noise, by chance
            assert await asked_on(wire, ONE) == rtu_frame(ONE_ANSWER)
            assert published.zero.state.count == 0
            answer = await asked_on(wire, SET_ZERO)
            assert answer == rtu_frame(SET_ZERO if is_allowed else bytes.fromhex("86 01"))
            assert published.zero.state.count == int(is_allowed)
    finally:
        wire.hang_up()


async def asked_on(wire: Wire, pdu: bytes) -> bytes:
    """The answer to a request after a silence."""
    await asyncio.sleep(0.15)
    wire.send(rtu_frame(pdu))
    length = len(rtu_frame(ONE_ANSWER)) if pdu == ONE else 5
    heard = await wire.receive(lambda data: len(data) >= length)
    if heard[1] == 6:
        heard += await wire.receive(lambda data: len(heard + data) >= 8)
    return heard
