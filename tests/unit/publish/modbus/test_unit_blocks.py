"""The blocks of the unit and its condition, discrete inputs, word orders, the functions of serial lines."""

import asyncio
import struct
import subprocess
import zlib
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from support.clock import FakeClock
from support.foreign import need_program
from support.modbus_wire import UNIT, Client, Measured, connected
from support.serving import serving
from support.status_fixtures import checked, figures_of
from support.wire import socat_line

from altd.config import ModbusRtuPortSettings
from altd.publish.modbus.registers import Type, WordOrder
from altd.publish.modbus.responder import CONDITION, TABLES, LineCounters, serial_response
from altd.publish.modbus.responder import UNIT as UNIT_TABLE
from altd.publish.modbus.rtu import ModbusRtuPublisher
from altd.reasons import Reason, Signal
from altd.records import Fault
from altd.records.sensors import Quality, SensorValue
from altd.status.availability import Availability
from altd.status.board import Board
from altd.status.cause import StateReport
from altd.status.health import Component, Health
from altd.status.target_area import TargetArea
from altd.status.unit import PublishedUnit, UnitFacts

from .conftest import tcp_of

CREATED = "2026-11-02T09:30:00.000Z"
CHECKSUM = "sha256:89abcdef" + 56 * "0"
"""As a calibration file has it."""


ALWAYS_KNOWN = "block_version", "unit", "session", "uptime", "lost_frames", "late_frames"


class NoFiles:
    name = "cal.json"


@pytest.fixture
def published(board: Board, health: Health) -> PublishedUnit:
    """Of a unit whose front target is seen by a camera of another name."""
    facts = UnitFacts(version="0.1.0", serial="ALT-0007", config_sha256="01234567" + 56 * "f")
    targets = TargetArea("front", 0.0, (), "left"), TargetArea("rear", 280.0, (), "rear")
    published = PublishedUnit(board, health, facts, targets)
    published.calibration, published.calibration_files = figures_of(CREATED, CHECKSUM), NoFiles()  # type: ignore[arg-type]
    published.operating_hours = lambda: 812.4
    health.component("camera left").observe({"exposure_ms": 2.5, "gain_db": 3.0})
    health.component("camera left").count("lost", 3)
    health.component("camera rear").observe({"exposure_ms": None})
    measuring = health.component("measuring")
    measuring.observe({"diameter_front_px": 61.5, "peak_front": 180.0, "peak_rear": None})
    measuring.counters |= {"late_frames": 5, "dropped_left": 1, "dropped_rear": 70_000}
    for name, celsius in (("housing", 31.5), ("rear", -4.0)):
        health.component(f"temperature {name}").observe({"celsius": celsius})
    return published


@pytest.fixture
async def client(published: PublishedUnit, component: Component) -> Any:
    publisher = tcp_of(published, component)
    async with serving(publisher), connected(publisher) as client:
        yield client


async def read(client: Client, address: int, count: int) -> bytes:
    answer = await client.ask(struct.pack(">BHH", 3, address, count))
    assert answer[:2] == bytes([3, 2 * count]), answer.hex()
    return answer[2:]


def values(content: bytes, first: int, layout: dict[int, str]) -> dict[int, Any]:
    """By address, as struct reads them."""
    return {
        address: struct.unpack_from(f">{form}", content, 2 * (address - first))[0]
        for address, form in layout.items()
    }


def test_rows_are_in_order_do_not_overlap_and_no_two_tables_share_an_address() -> None:
    for table in TABLES:
        assert table.size <= 125
        for row, following in pairwise(table.rows):
            assert row.address + row.type.words <= following.address
        assert table.first <= table.rows[0].address
        assert table.rows[-1].address + table.rows[-1].type.words <= table.first + table.size
        assert all(row.address % 2 == 0 for row in table.rows if row.type.words > 1)
    for table, following in pairwise(TABLES):
        assert table.first + table.size <= following.first


def test_no_published_address_of_these_blocks_moves() -> None:
    """A contract with controllers."""
    assert {row.name: row.address for row in UNIT_TABLE.rows} == {
        "block_version": 300, "rehearsal": 301, "unit": 302, "session": 304, "uptime": 306,
        "calibration_date": 308, "calibration_age": 310, "operating_hours": 311, "calibration_checksum": 312,
        "config_checksum": 314, "firmware": 316, "serial": 324,
    }  # fmt: skip
    assert {row.name: row.address for row in CONDITION.rows} == {
        "block_version": 400, "state": 401, "self_check": 402, "self_check_age": 404,
        "valid_last_hour": 406, "valid_last_day": 407, "valid_last_31_days": 408, "valid_since_start": 409,
        "lost_frames": 410, "late_frames": 412,
        "front_exposure": 414, "front_gain": 416, "front_diameter": 418, "front_peak": 420,
        "rear_exposure": 422, "rear_gain": 424, "rear_diameter": 426, "rear_peak": 428,
        "temperature_1": 430, "temperature_2": 432, "temperature_3": 434, "temperature_4": 436,
        "roll": 438, "sigma_roll": 440, "roll_age": 442,
    }  # fmt: skip


async def test_the_unit_says_which_it_is(
    client: Client, board: Board, clock: FakeClock, measured: Measured
) -> None:
    board.publish(measured())
    clock.now_ns += 90_000_000_000
    content = await read(client, 300, 50)
    layout = {300: "H", 301: "H", 306: "I", 308: "I", 310: "H", 311: "H", 312: "I", 314: "I"}
    assert values(content, 300, layout) == {
        300: 1, 301: 0, 306: 90, 308: 20261102, 310: 17, 311: 812, 312: 0x89ABCDEF, 314: 0x01234567
    }  # fmt: skip
    assert content[32:48] == b"0.1.0".ljust(16, b"\0")
    assert content[48:80] == b"ALT-0007".ljust(32, b"\0")
    assert values(content, 300, {302: "I", 304: "I"}) == {
        302: board.identity.unit,
        304: board.identity.session,
    }


async def test_a_serial_of_any_length_and_letters_is_text(client: Client, published: PublishedUnit) -> None:
    published.facts = published.facts.model_copy(update={"serial": "Ä" + 63 * "7"})
    assert (await read(client, 324, 16)) == b"?" + 31 * b"7"


async def test_what_a_bare_unit_does_not_know_is_not_known(
    board: Board, component: Component, clock: FakeClock
) -> None:
    bare = tcp_of(PublishedUnit(board, Health(clock)), component)
    async with serving(bare), connected(bare) as client:
        for table in (UNIT_TABLE, CONDITION):
            content = await read(client, table.first, table.size)
            words = list(struct.unpack(f">{table.size}H", content))
            for row in table.rows:
                place = row.address - table.first
                if row.name not in ALWAYS_KNOWN:
                    assert tuple(words[place : place + row.type.words]) == row.type.unknown, row.name


async def test_the_condition_is_that_of_now(
    client: Client,
    board: Board,
    health: Health,
    published: PublishedUnit,
    clock: FakeClock,
    measured: Measured,
) -> None:
    availability = Availability(clock.now_ns)
    availability.update(clock.now_ns, None)
    clock.now_ns += 3_000_000_000
    availability.update(clock.now_ns, None)
    clock.now_ns += 1_000_000_000
    availability.update(clock.now_ns, "spot_missing")
    published.state = lambda: StateReport(Signal.OUT_OF_SPECIFICATION, 0, clock.now_ns, (), availability)
    published.self_check.unavailable = ""
    health.component("camera left").observe({"exposure_ms": 2.5, "gain_db": 3.0})
    assert values(await read(client, 400, 60), 400, {402: "H", 404: "I"}) == {402: 0, 404: 0xFFFFFFFF}
    published.self_check.publish(checked(1, verdict="suspect"))
    health.component("temperature housing").observe({"celsius": 31.5})
    health.component("measuring").observe({"diameter_front_px": 61.5, "peak_front": 180.0})
    said = SensorValue(Quality.GOOD, value=1.25, sigma=0.01, t_ns=clock.now_ns, expires_ns=2**62)
    board.publish(measured().with_sensors({"roll_deg": said}))
    clock.now_ns += 2_000_000_000
    content = await read(client, 400, 60)
    whole = {401: "H", 402: "H", 404: "I", 406: "H", 409: "H", 410: "I", 412: "I"}
    assert values(content, 400, whole) == {
        401: 3, 402: 2, 404: 2, 406: 7500, 409: 7500, 410: 70_004, 412: 5,
    }  # fmt: skip
    floats = values(content, 400, dict.fromkeys(range(414, 442, 2), "f"))
    assert [floats[address] for address in (414, 416, 418, 420)] == [2.5, 3.0, 61.5, 180.0]
    assert all(floats[address] != floats[address] for address in (422, 424, 426, 428, 434, 436))
    assert floats[430] == 31.5
    assert values(content, 400, {438: "f", 442: "H"}) == {438: 1.25, 442: 2000}
    clock.now_ns += 3_000_000_000
    later = values(await read(client, 400, 60), 400, {414: "f", 418: "f", 430: "f"})
    assert all(figure != figure for figure in later.values())  # nothing was observed for 2.5 s


@pytest.mark.parametrize(
    ("status", "signal", "bits"),
    [
        ((), Signal.GOOD, 0b0000001),
        ((Fault(Reason.SPOT_MISSING, "rear"),), Signal.OUT_OF_SPECIFICATION, 0b0001000),
        ((Fault(Reason.CAMERA_SILENT, "rear"),), Signal.FAILURE, 0b0000010),
        ((Fault(Reason.EXPOSURES_LOST),), Signal.MAINTENANCE_REQUIRED, 0b0010001),
        ((Fault(Reason.PLAYBACK),), Signal.CHECK_FUNCTION, 0b0100100),
    ],
)
async def test_discrete_inputs_are_validity_and_the_signals(
    client: Client,
    board: Board,
    published: PublishedUnit,
    measured: Measured,
    status: Any,
    signal: Signal,
    bits: int,
) -> None:
    published.state = lambda: StateReport(signal, 0, 0, (), Availability(0))
    is_valid = all(fault.reason.is_warning for fault in status)
    board.publish(measured(status=status) if is_valid else measured(beam=None, status=status))
    assert await client.ask(bytes.fromhex("02 0000 0007")) == bytes([2, 1, bits])
    for address in range(7):
        asked = struct.pack(">BHH", 2, address, 1)
        assert await client.ask(asked) == bytes([2, 1, bits >> address & 1])


async def test_a_rehearsal_has_an_input_and_a_register(
    component: Component, clock: FakeClock, measured: Measured
) -> None:
    board = Board(clock, 1.0, measured().quantities, rehearsal=True)
    board.publish(measured(status=(Fault(Reason.SIMULATED),)))
    publisher = tcp_of(PublishedUnit(board, Health(clock)), component)
    async with serving(publisher), connected(publisher) as client:
        assert await client.ask(bytes.fromhex("02 0000 0007")) == bytes([2, 1, 0b1100001])
        assert await read(client, 301, 1) == b"\0\1"


async def test_before_the_first_measurement_no_input_says_valid(client: Client) -> None:
    assert await client.ask(bytes.fromhex("02 0000 0001")) == bytes.fromhex("02 01 00")


ORDERS = {"ABCD": (0, 1, 2, 3), "CDAB": (2, 3, 0, 1), "BADC": (1, 0, 3, 2), "DCBA": (3, 2, 1, 0)}


@pytest.mark.parametrize("order", WordOrder)
async def test_every_32_bit_value_follows_the_word_order_and_nothing_else_does(
    board: Board, component: Component, published: PublishedUnit, measured: Measured, order: WordOrder
) -> None:
    board.publish(measured())
    found: dict[str, dict[int, bytes]] = {}
    for each in (WordOrder.ABCD, order):
        publisher = tcp_of(published, component, word_order=each.value)
        async with serving(publisher), connected(publisher) as client:
            found[each] = {table.first: await read(client, table.first, table.size) for table in TABLES}
    assert found[order][0][200:208] == bytes(
        bytes.fromhex("42f6e979 12345678")[4 * value + place] for value in (0, 1) for place in ORDERS[order]
    )
    for table in TABLES:
        plain, ordered = found["ABCD"][table.first], found[order][table.first]
        for row in table.rows:
            begin = 2 * (row.address - table.first)
            value = plain[begin : begin + 2 * row.type.words]
            if row.type in (Type.U32, Type.S32, Type.F32):
                value = bytes(value[place] for place in ORDERS[order])
            if row.name not in ("message", "crc32"):
                assert ordered[begin : begin + len(value)] == value, (row.name, order)


@pytest.mark.parametrize("order", WordOrder)
async def test_the_crc_is_over_the_bytes_as_they_are_sent(
    board: Board, component: Component, published: PublishedUnit, measured: Measured, order: WordOrder
) -> None:
    board.publish(measured())
    publisher = tcp_of(published, component, word_order=order.value)
    async with serving(publisher), connected(publisher) as client:
        block = await read(client, 200, 80)
    sent = bytes(block[-4:][place] for place in ORDERS[order])  # each order is its own inverse
    assert int.from_bytes(sent) == zlib.crc32(block[:-4])


@pytest.mark.parametrize(("order", "arguments"), [("ABCD", ("-B",)), ("CDAB", ())])
async def test_mbpoll_reads_floats_in_the_order_that_is_set(
    published: PublishedUnit, component: Component, order: Any, arguments: tuple[str, ...]
) -> None:
    publisher = tcp_of(published, component, word_order=order)
    async with serving(publisher):
        command = [need_program("mbpoll"), "-1", "-0", *arguments, "-t", "3:float", "-r", "100"]
        command += ["-p", str(publisher.port), "-a", str(UNIT), "127.0.0.1"]
        done = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=60)
    assert "[100]: \t123.456\n" in done.stdout


async def test_pymodbus_reads_the_identification_with_serial_and_calibration(
    published: PublishedUnit, component: Component
) -> None:
    publisher = tcp_of(published, component)
    async with serving(publisher):
        client = AsyncModbusTcpClient("127.0.0.1", port=publisher.port)
        assert await client.connect()
        answer = await client.read_device_information(read_code=3, object_id=0, device_id=UNIT)
        client.close()
        inputs = AsyncModbusTcpClient("127.0.0.1", port=publisher.port)
        assert await inputs.connect()
        assert (await inputs.read_discrete_inputs(0, count=7, device_id=UNIT)).bits[:7] == 7 * [False]
        inputs.close()
    assert {number: answer.information[number] for number in (0, 0x80, 0x81, 0x82)} == {
        0: b"altd",
        0x80: b"ALT-0007",
        0x81: b"2026-11-02",
        0x82: CHECKSUM.encode(),
    }


async def test_the_identification_of_the_longest_serial_fits_into_one_response(
    client: Client, published: PublishedUnit
) -> None:
    published.facts = published.facts.model_copy(update={"serial": 64 * "7"})
    answer = await client.ask(bytes.fromhex("2b 0e 03 00"))
    assert answer[6] == 7
    assert len(answer) <= 253


class TestSerialLine:
    """As pymodbus asks over a real pair of serial ports."""

    async def test_counters_server_id_and_echo(
        self, tmp_path: Path, published: PublishedUnit, component: Component
    ) -> None:
        with socat_line(tmp_path) as (unit, controller, _):
            port = ModbusRtuPortSettings(device=unit, speaks="modbus_rtu", baud=115200, unit_id=UNIT)
            async with serving(ModbusRtuPublisher(port, published, component)):
                client = AsyncModbusSerialClient(str(controller), baudrate=115200)
                assert await client.connect()
                for _ in range(3):  # its own answer looks the same
                    assert (await client.diag_query_data(b"\x12\x34", device_id=UNIT)).message == b"\x12\x34"
                    await asyncio.sleep(0.15)
                assert (await client.read_holding_registers(130, count=1, device_id=UNIT)).isError()
                assert (await client.diag_read_bus_message_count(device_id=UNIT)).message == 5
                assert (await client.diag_read_bus_exception_error_count(device_id=UNIT)).message == 1
                assert (await client.diag_read_device_message_count(device_id=UNIT)).message == 7
                assert (await client.diag_restart_communication(False, device_id=UNIT)).isError()
                client.close()

    async def test_mbpoll_reports_the_server_id(
        self, tmp_path: Path, published: PublishedUnit, component: Component
    ) -> None:
        with socat_line(tmp_path) as (unit, controller, _):
            port = ModbusRtuPortSettings(device=unit, speaks="modbus_rtu", baud=19200, unit_id=UNIT)
            async with serving(ModbusRtuPublisher(port, published, component)):
                command = [need_program("mbpoll"), "-u", "-m", "rtu", "-b", "19200", "-P", "none"]
                command += ["-a", str(UNIT), str(controller)]
                run = partial(subprocess.run, command, capture_output=True, text=True, timeout=60)
                done = await asyncio.to_thread(run)
        assert "Id    : 0xA1" in done.stdout, done.stdout + done.stderr
        assert "Status: On" in done.stdout
        assert "ALT 0.1.0 ALT-0007" in done.stdout

    @pytest.mark.parametrize(
        ("request_hex", "answer_hex"),
        [
            ("08 000a 0000", "08 000a 0000"),
            ("08 000b 0001", "88 03"),
            ("08 0004 0000", "88 01"),
            ("08 000b", "88 03"),
            ("08", "88 03"),
            ("11 00", "91 03"),
        ],
    )
    def test_what_is_asked_wrongly_is_an_exception(
        self, published: PublishedUnit, request_hex: str, answer_hex: str
    ) -> None:
        counters = LineCounters(messages=70_000, errors=1)
        asked = bytes.fromhex(request_hex)
        assert serial_response(asked, counters, published.facts) == bytes.fromhex(answer_hex)
        is_cleared = asked[:3] == bytes.fromhex("08 000a")
        assert counters.messages == (0 if is_cleared else 70_000)


async def test_a_defect_costs_the_request_that_meets_it_and_no_client_its_connection(
    client: Client, published: PublishedUnit, caplog: pytest.LogCaptureFixture
) -> None:
    published.facts = published.facts.model_copy(update={"config_sha256": "no digits"})
    for _ in range(3):
        assert await client.ask(bytes.fromhex("03 012c 0032")) == bytes.fromhex("83 04")
    assert await client.ask(bytes.fromhex("04 0066 0002")) == bytes.fromhex("04 04 12345678")
    assert "a defect, at request 03012c0032" in caplog.text
