"""The checked block against what the page promises; CRC and decoding are Python's own, not the product's."""

import math
import struct
import zlib

import pytest
from support.clock import FakeClock
from support.modbus_wire import EVERYTHING, Client, Measured, words

from altd.config import ModbusTcpSettings
from altd.publish.modbus.checked_block import ROWS, CheckedBlock
from altd.publish.modbus.responder import Responder
from altd.reasons import Reason, Signal
from altd.records import Fault
from altd.records.spots import Motion
from altd.status.availability import Availability
from altd.status.board import Board
from altd.status.cause import StateReport
from altd.status.health import Health
from altd.status.proof import Identity, Stamp
from altd.status.unit import PublishedUnit
from tools.pages.example import view_of

BLOCK = struct.pack(">BHH", 4, 200, 80)
OF_NOW = struct.pack(">BHH", 4, 50, 42)
"""sigma_now of the first table: x, y, yaw, pitch from 50 on, and x as an integer at 90."""
HEAD = struct.Struct(">HHIIIIIIIHHIHHHH")
"""Addresses 200 to 223."""


def bytes_of(registers: tuple[int, ...] | list[int]) -> bytes:
    return struct.pack(f">{len(registers)}H", *registers)


def is_intact(registers: tuple[int, ...] | list[int]) -> bool:
    sent = bytes_of(registers)
    return zlib.crc32(sent[:-4]) == int.from_bytes(sent[-4:], "big")


def test_no_published_address_moves() -> None:
    """A controller that has not been changed would take a rate for a sigma."""
    axes = ("x", "y", "yaw", "pitch")
    names = (
        *(*axes, "roll", *(f"sigma_{axis}" for axis in (*axes, "roll"))),
        *(f"sigma_now_{axis}" for axis in axes),
        *(f"rate_{axis}" for axis in axes),
        *(f"sigma_random_{axis}" for axis in axes),
    )
    addresses = {row.name: row.address for row in ROWS}
    assert {name: addresses[name] for name in names} == dict(zip(names, range(230, 274, 2), strict=True))


async def test_one_read_gives_all_that_a_controller_needs(
    client: Client, clock: FakeClock, board: Board, measured: Measured
) -> None:
    clock.now_ns += 5_000_000_000
    board.publish(measured(roll_deg=0.25))
    read = words(await client.ask(BLOCK))
    assert is_intact(read)
    head = HEAD.unpack(bytes_of(read)[: HEAD.size])
    version, state, unit, session, message, clock_ms, published, sequence = head[:8]
    assert (version, state, unit) == (1, 0xFFFF, zlib.crc32(b"ALT-0007"))
    assert session == board.identity.session
    assert (message, clock_ms, published, sequence) == (1, 5000, 1, 160)
    assert head[8:] == (1_795_162_530, 125, 20, 520, 1, 0, 0, 0)
    values = struct.unpack(">10f", bytes_of(read[30:50]))
    expected = (10.012, 4.987, 1.1459, -1.7184, 0.25, 0.004, 0.005, 0.0011, 0.0012)
    assert values[:9] == pytest.approx(expected, rel=1e-7)
    assert math.isnan(values[9])
    of_now = struct.unpack(">8f", bytes_of(read[50:66]))
    assert all(map(math.isnan, of_now))  # it is not known how this one moves
    random = struct.unpack(">4f", bytes_of(read[66:74]))
    assert random == pytest.approx((0.003, 0.0045, 0.0009, 0.001), rel=1e-7)
    assert set(read[24:30] + read[74:78]) == {0}


async def test_only_message_clock_age_and_crc_differ_between_two_reads_of_a_measurement(
    client: Client, clock: FakeClock, board: Board, measured: Measured
) -> None:
    board.publish(measured())
    first = words(await client.ask(BLOCK))
    clock.now_ns += 40_000_000
    second = words(await client.ask(BLOCK))
    assert is_intact(first)
    assert is_intact(second)
    changed = {200 + place for place in range(80) if first[place] != second[place]}
    assert changed <= {206, 207, 208, 209, 218, 219, 278, 279}
    as_u32 = struct.Struct(">I").unpack
    assert [as_u32(bytes_of(second[place : place + 2]))[0] for place in (6, 8, 18)] == [2, 40, 560]


async def test_sigma_of_now_grows_from_read_to_read_while_rates_stay(
    client: Client, clock: FakeClock, board: Board, measured: Measured
) -> None:
    """2 mm/s and 0.02 °/s: in 0.52 s, and in 0.4 s more, beside a sigma of 0.004 mm and 0.0012°."""
    x = Motion(2.0, 0.01, 0.0, 0.0, 0.475, 0.083, probable_rate=2.0, acceleration=0.0)
    pitch = Motion(-0.02, 0.001, 0.0, 0.0, 0.475, 0.083, probable_rate=0.02, acceleration=0.0)
    board.publish(measured(motions={"x_mm": x, "pitch_deg": pitch}))
    first, others = words(await client.ask(BLOCK)), [words(await client.ask(OF_NOW))]
    clock.now_ns += 400_000_000
    second = words(await client.ask(BLOCK))
    others.append(words(await client.ask(OF_NOW)))
    for read, other, age_s in zip((first, second), others, (0.52, 0.92), strict=True):
        assert is_intact(read)
        assert other[:8] == read[50:58], "the first table has another sigma_now"
        scaled = struct.unpack(">i", bytes_of(other[40:42]))[0]
        assert scaled == pytest.approx(1e4 * math.hypot(0.004, 2.0 * age_s), abs=1)
        sigma_now, rates = (struct.unpack(">4f", bytes_of(read[place : place + 8])) for place in (50, 58))
        assert sigma_now[0] == pytest.approx(math.hypot(0.004, 2.0 * age_s), rel=1e-6)
        assert sigma_now[3] == pytest.approx(math.hypot(0.0012, 0.02 * age_s), rel=1e-6)
        assert (rates[0], rates[3]) == pytest.approx((2.0, -0.02), rel=1e-6)
        assert all(map(math.isnan, sigma_now[1:3] + rates[1:3]))
    assert first[40:48] == second[40:48]  # that of the measurement stays


async def test_before_the_first_measurement_the_block_is_whole_and_says_so(client: Client) -> None:
    read = words(await client.ask(BLOCK))
    assert is_intact(read)
    assert read[20] == 1 << 1
    assert read[10:12] == (0, 0)
    assert read[12:17] == (0xFFFF,) * 5
    assert read[18:20] == (0xFFFF, 0xFFFF)


async def test_a_stale_measurement_has_no_numbers_and_goes_on_ageing(
    client: Client, clock: FakeClock, board: Board, measured: Measured
) -> None:
    board.publish(measured())
    clock.now_ns += 2_000_000_000
    read = words(await client.ask(BLOCK))
    assert is_intact(read)
    assert read[20] == 1 << 2
    assert read[18:20] == (0, 2520)
    assert all(math.isnan(value) for value in struct.unpack(">10f", bytes_of(read[30:50])))


async def test_a_read_of_a_part_is_answered(client: Client, board: Board, measured: Measured) -> None:
    board.publish(measured())
    assert words(await client.ask(struct.pack(">BHH", 3, 202, 2))) == struct.unpack(
        ">2H", zlib.crc32(b"ALT-0007").to_bytes(4, "big")
    )
    assert words(await client.ask(struct.pack(">BHH", 4, 279, 1)))


async def test_the_old_registers_count_no_message(client: Client, board: Board, measured: Measured) -> None:
    board.publish(measured())
    await client.ask(EVERYTHING)
    assert words(await client.ask(BLOCK))[6:8] == (0, 1)


def test_a_board_of_no_unit_reads_not_known(measured: Measured) -> None:
    block = CheckedBlock().at(view_of(measured(), 0.52, 1, Stamp(Identity(), 3, 9)))
    assert block[2:6] == [0xFFFF] * 4
    assert is_intact(block)


def test_reasons_and_status_are_those_of_the_map(measured: Measured) -> None:
    fault = Fault(Reason.SPOT_MISSING, "rear")
    view = view_of(measured(beam=None, status=(fault,)), 0.5, 1, Stamp(Identity(1, 2), 3, 4))
    assert CheckedBlock().at(view)[20:24] == [1 << 9, 0, 0, 1]


def test_counters_wrap_without_ever_reading_not_known(measured: Measured) -> None:
    for count, expected in ((0xFFFF_FFFE, [0xFFFF, 0xFFFE]), (0xFFFF_FFFF, [0, 0])):
        view = view_of(measured(), 0.5, count, Stamp(Identity(1, 2), 3, 4))
        assert CheckedBlock().at(view)[10:12] == expected


@pytest.mark.parametrize("signal", Signal)
async def test_the_state_is_the_signal_of_the_moment_of_each_reading(
    board: Board,
    health: Health,
    published: PublishedUnit,
    clock: FakeClock,
    measured: Measured,
    signal: Signal,
) -> None:
    shown, nothing_observed = Signal.GOOD, Availability(0)
    published.state = lambda: StateReport(shown, 0, 0, (), nothing_observed)
    responder = Responder(ModbusTcpSettings(), published, health.component("modbus"))
    board.publish(measured())
    first = words(responder.answer(BLOCK))
    shown = signal
    second = words(responder.answer(BLOCK))
    numbers = {
        "good": 0,
        "failure": 1,
        "check_function": 2,
        "out_of_specification": 3,
        "maintenance_required": 4,
    }
    assert (first[1], second[1]) == (0, numbers[signal])
    assert is_intact(second)
