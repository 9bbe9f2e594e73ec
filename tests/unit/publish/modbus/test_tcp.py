"""Modbus TCP: what a request gets for an answer."""

import asyncio
import math
import struct
from typing import Any

import pytest
from support.modbus_wire import EVERYTHING, ONE, ONE_ANSWER, UNIT, Client, Measured, connected, frame, words

from altd import __version__
from altd.instruments.beam.solver import Beam
from altd.publish.modbus import registers
from altd.publish.modbus.registers import SIZE
from altd.publish.modbus.tcp import ModbusTcpPublisher
from altd.status.board import Board
from altd.status.health import Component

VERSION = __version__.encode()


async def test_input_and_holding_registers_are_the_same(
    client: Client, board: Board, measured: Measured
) -> None:
    board.publish(measured())
    as_input = await client.ask(struct.pack(">BHH", 4, 0, SIZE))
    as_holding = await client.ask(struct.pack(">BHH", 3, 0, SIZE))
    assert as_input[0] == 4
    assert as_holding[0] == 3
    assert as_input[1:] == as_holding[1:]
    assert struct.unpack(">f", as_input[2 + 40 : 2 + 44])[0] == pytest.approx(10.012)


async def test_any_part_of_the_table_can_be_read(client: Client) -> None:
    whole = words(await client.ask(EVERYTHING))
    for address, count in ((0, 1), (103, 4), (SIZE - 1, 1), (21, 2)):
        part = words(await client.ask(struct.pack(">BHH", 4, address, count)))
        assert part == whole[address : address + count]


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("04 0000 0000", "84 03"),
        ("04 0000 007e", "84 03"),
        ("04 0000", "84 03"),
        ("04", "84 03"),
        ("04 0066 0002 00", "84 03"),
        ("04 0001 0078", "84 02"),
        ("03 0078 0001", "83 02"),
        ("04 ffff 007d", "84 02"),
        ("01 0000 0001", "81 01"),
        ("02 0007 0001", "82 02"),
        ("02 0000 0000", "82 03"),
        ("02 0000 07d1", "82 03"),
        ("02 0000 0001 00", "82 03"),
        ("04 00f0 0050", "84 02"),
        ("04 0077 0002", "84 02"),
        ("04 00c7 0051", "84 02"),
        ("04 00c8 0051", "84 02"),
        ("04 0118 0001", "84 02"),
        ("04 012c 0033", "84 02"),
        ("04 01cb 0002", "84 02"),
        ("06 0000 1234", "86 01"),
        ("07", "87 01"),
        ("08 0000 1234", "88 01"),
        ("11", "91 01"),
        ("2b 0d 00 00", "ab 01"),
        ("2b 0e 00 00", "ab 03"),
        ("2b 0e 05 00", "ab 03"),
        ("2b 0e 04 03", "ab 02"),
        ("2b", "ab 03"),
        ("63 00", "e3 01"),
        ("00", "80 01"),
        ("84 02", "84 01"),
        ("ff", "ff 01"),
    ],
)
async def test_what_cannot_be_answered_gets_the_exception_that_says_why(
    client: Client, component: Component, request_hex: str, answer_hex: str
) -> None:
    assert await client.ask(bytes.fromhex(request_hex)) == bytes.fromhex(answer_hex)
    assert await client.ask(ONE) == ONE_ANSWER
    assert component.counters["requests"] == 2
    assert component.counters["exceptions"] == 1
    assert component.data_given == 1


async def test_the_device_identifies_itself(client: Client) -> None:
    answer = await client.ask(bytes.fromhex("2b 0e 01 00"))
    assert answer[:4] == bytes.fromhex("2b 0e 01 83")
    assert answer[7:].startswith(b"\x00\x04altd\x01\x03ALT\x02")


@pytest.mark.parametrize("read_code", [1, 2, 3])
@pytest.mark.parametrize("unknown", [3, 5, 7, 0x7F, 0x80, 0xFF])
async def test_a_stream_from_an_unknown_object_starts_again_at_object_0(
    client: Client, read_code: int, unknown: int
) -> None:
    """V1.1b3, 6.21: "the server responds as if object 0 were pointed out"."""
    from_0 = await client.ask(bytes([0x2B, 0x0E, read_code, 0]))
    assert from_0[6] == {1: 3, 2: 4, 3: 4}[read_code]
    assert await client.ask(bytes([0x2B, 0x0E, read_code, unknown])) == from_0


async def test_a_stream_goes_on_from_a_known_object(client: Client) -> None:
    answer = await client.ask(bytes.fromhex("2b 0e 02 02"))
    assert answer[:9] == bytes.fromhex("2b 0e 02 83 00 00 02 02") + bytes([len(VERSION)])
    assert answer[9:] == VERSION + b"\x04\x13Active Laser Target"


@pytest.mark.parametrize("unknown", [3, 5, 7, 0x7F, 0x80, 0xFF])
async def test_one_unknown_object_is_an_illegal_address(client: Client, unknown: int) -> None:
    assert await client.ask(bytes([0x2B, 0x0E, 4, unknown])) == bytes.fromhex("ab 02")
    assert (await client.ask(bytes.fromhex("2b 0e 04 01")))[6:] == b"\x01\x01\x03ALT"


@pytest.mark.parametrize("unit", [UNIT, 0, 255])
async def test_a_direct_device_answers_to_its_unit_id_and_to_0_and_255(client: Client, unit: int) -> None:
    client.send(frame(ONE, transaction=0xBEEF, unit=unit))
    assert await client.hear() == (0xBEEF, unit, ONE_ANSWER)


async def test_another_unit_id_is_told_that_nobody_is_there(client: Client, component: Component) -> None:
    assert await client.ask(ONE, unit=UNIT + 1) == bytes([0x84, 0x0B])
    assert component.counters == {"clients": 1, "other_units": 1}


async def test_pipelined_requests_are_all_answered_in_their_order(client: Client) -> None:
    client.send(b"".join(frame(ONE, transaction) for transaction in range(200)))
    assert [await client.hear() for _ in range(200)] == [(count, UNIT, ONE_ANSWER) for count in range(200)]


async def test_a_request_may_come_byte_by_byte(client: Client) -> None:
    for byte in frame(ONE):
        client.send(bytes([byte]))
        await asyncio.sleep(0.001)
    assert await client.hear() == (1, UNIT, ONE_ANSWER)


async def test_an_answer_is_one_measurement_while_the_writer_goes_on(
    tcp: ModbusTcpPublisher, board: Board, measured: Measured
) -> None:
    async def writer() -> None:
        for count in range(300):
            value = count / 4
            beam = Beam(value, value, value, value, value, value, value, value)
            board.publish(
                measured(
                    sequence=count,
                    frames=count,
                    beam=beam,
                    points_mm=dict.fromkeys(("front", "rear"), (value, value)),
                )
            )
            await asyncio.sleep(0)

    async def reader() -> set[int]:
        sequences = set()
        async with connected(tcp) as client:
            while board.published < 300:
                image = await client.ask(EVERYTHING)
                if not board.published or words(image)[0] == 0b10:
                    continue
                (count,) = struct.unpack(">I", image[18:22])
                values = struct.unpack(">15f", image[42:102])
                assert {*values[:4], *values[7:]} == {count / 4}
                assert words(image)[5] == count + 1
                assert words(image)[7] == count
                sequences.add(count)
        return sequences

    seen, _ = await asyncio.gather(reader(), writer())
    assert len(seen) > 5


async def test_a_stale_measurement_loses_its_numbers_and_the_heartbeat_stands(
    client: Client, clock: Any, board: Board, measured: Measured
) -> None:
    board.publish(measured())
    fresh = await client.ask(EVERYTHING)
    clock.now_ns += 2_000_000_000
    stale = await client.ask(EVERYTHING)
    assert (words(fresh)[0], words(stale)[0]) == (1, 1 << 2)
    assert (words(fresh)[6], words(stale)[6]) == (520, 2520)
    assert words(fresh)[5] == words(stale)[5] == 1
    assert all(math.isnan(value) for value in struct.unpack(">15f", stale[42:102]))


async def test_the_registers_are_made_once_a_measurement_and_age_for_each_request(
    client: Client, clock: Any, board: Board, measured: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Staleness, which comes with time alone, is seen at the first request after it and made once, too."""
    made: list[int] = []
    image = registers.image
    monkeypatch.setattr(registers, "image", lambda *of: made.append(1) or image(*of))
    seen = []
    for published in range(3):
        board.publish(measured(sequence=160 + published))
        for _ in range(4):
            seen.append(words(await client.ask(EVERYTHING)))
            clock.now_ns += 10_000_000
    assert len(made) == 3
    assert [image[9] for image in seen] == [160] * 4 + [161] * 4 + [162] * 4
    assert [image[6] for image in seen[:4]] == [520, 530, 540, 550]
    clock.now_ns += 1_000_000_000
    stale = [words(await client.ask(EVERYTHING)) for _ in range(5)]
    assert len(made) == 4
    assert {image[0] for image in seen} == {1}
    assert {image[0] for image in stale} == {1 << 2}
    board.publish(measured(sequence=163))
    assert words(await client.ask(EVERYTHING))[0] == 1
    assert len(made) == 5
