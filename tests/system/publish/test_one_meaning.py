"""One measurement, read on every interface: the same numbers, time, reasons, state and validity.

The readers are the standard library's: struct, json, zlib, and NMEA 0183 by hand; of OPC UA asyncua's client.
"""

import asyncio
import contextlib
import functools
import json
import math
import operator
import os
import struct
import zlib
from collections import Counter
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from asyncua import Client
from support.clock import FakeClock
from support.measurements import measured
from support.modbus_rtu_wire import crc
from support.opcua import OpcUaUnit, Written, connected
from support.opcua import read as read_nodes
from support.serving import serving
from support.wire import Wire

from altd.config import HttpSettings, ModbusRtuPortSettings, ModbusTcpSettings, TelegramPortSettings
from altd.instruments.beam.solver import Beam
from altd.publish.http.publisher import HttpPublisher
from altd.publish.modbus.rtu import ModbusRtuPublisher
from altd.publish.modbus.tcp import ModbusTcpPublisher
from altd.publish.opcua.process import ServedUnit
from altd.publish.opcua.quality import Status
from altd.publish.serial.publisher import TelegramPublisher
from altd.reasons import Reason, Scope
from altd.records import Fault, Measurement
from tools.pages.example import NAMEPLATE

MEASUREMENTS = int(os.environ.get("ALTD_BENCH_MEASUREMENTS", "500"))
"""`make fuzz`: 5,000."""
KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
INTERVAL_S = 0.05
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True)
class Said:
    """An interface's copy of a measurement; None: not known. Values and sigmas in mm and degrees."""

    valid: bool
    sequence: int
    time_ms: int
    values: tuple[float | None, ...]
    sigmas: tuple[float | None, ...]
    frames: int
    reasons: frozenset[str] | None = None
    """None: the interface has no words."""
    state: int | None = None
    unit: int | None = None
    session: int | None = None


FOUND = np.array(
    [
        Fault(reason, target, "for a person")
        for reason in Reason
        if reason not in ("not_live", "rehearsal")  # which the board adds
        for target in (("front", "rear") if reason.scope is Scope.TARGET else (None,))
    ],
    object,
)


def found_by(rng: np.random.Generator, number: int) -> list[Fault]:
    """Each fault alone, then each before another one, then any: none in two of seven cases."""
    rounds, place = divmod(number, len(FOUND))
    if rounds < 2:
        others = np.delete(FOUND, place)
        return [FOUND[place], *rng.choice(others, rounds)]
    return list(rng.choice(FOUND, rng.choice([0, 0, 1, 1, 1, 2, 3]), replace=False))


def drawn(rng: np.random.Generator, number: int, t_ns: int) -> Measurement:
    """A measurement of a beam anywhere, at any time."""
    status = found_by(rng, number)
    is_valid = all(fault.reason.is_warning for fault in status)
    size = 10.0 ** rng.uniform(-4, 1.8, 4)
    x, y, yaw, pitch = (rng.choice([-1.0, 1.0], 4) * size).tolist()
    beam = Beam(x, y, yaw / 10, pitch / 10, *(10.0 ** rng.uniform(-4, -0.5, 4)).tolist())
    points = {"front": (x, y), "rear": (x + 1.0, y - 1.0)}
    return measured(
        beam if is_valid else None,
        points if is_valid else dict.fromkeys(points),
        sequence=int(rng.integers(0, 2**32 - 2)) if number % 10 == 0 else number,
        t_ns=t_ns,
        time=datetime(2026, 11, 20, tzinfo=UTC) + timedelta(milliseconds=int(rng.integers(0, 10**10))),
        frames=int(rng.integers(10, 21)) if is_valid else 0,
        status=tuple(status),
    )


class Unit:
    """A board with interfaces on real sockets and pseudo-terminals."""

    def __init__(self, rehearsal: bool) -> None:
        self.clock = FakeClock(10**9)
        self.opcua = OpcUaUnit(self.clock, rehearsal=rehearsal)
        self.board, self.health = self.opcua.board, self.opcua.health
        self.published = self.opcua.published

    @contextlib.asynccontextmanager
    async def served(self) -> Any:
        wires = [Wire.laid() for _ in range(2)]
        component = self.health.component
        local: dict[str, Any] = {"host": "127.0.0.1", "port": 0}
        tcp = ModbusTcpPublisher(ModbusTcpSettings(**local), self.published, component("modbus_tcp"))
        http = HttpPublisher(HttpSettings(**local), self.published, component("http"))
        line: dict[str, Any] = {"baud": 115200}
        rtu_line = ModbusRtuPortSettings(device=wires[0].device, speaks="modbus_rtu", **line)
        rtu = ModbusRtuPublisher(rtu_line, self.published, component("serial a"))
        nmea_line = TelegramPortSettings(
            device=wires[1].device, speaks="telegram", interval_s=INTERVAL_S, checked=True, **line
        )
        telegram = TelegramPublisher(nmea_line, self.board, component("serial b"), self.clock, NAMEPLATE)
        try:
            async with contextlib.AsyncExitStack() as stack:
                for interface in (tcp, http, rtu, telegram):
                    await stack.enter_async_context(serving(interface))
                nodes = await stack.enter_async_context(self.opcua.served())
                client = await stack.enter_async_context(connected(self.opcua.url))
                on_tcp = await asyncio.open_connection("127.0.0.1", tcp.port)
                try:
                    yield Readers(on_tcp, http.port, *wires, self.opcua, nodes, client)
                finally:
                    on_tcp[1].transport.abort()
        finally:
            for wire in wires:
                wire.hang_up()


Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@dataclass
class Readers:
    tcp: Connection
    http: int
    rtu: Wire
    nmea: Wire
    unit: OpcUaUnit
    nodes: ServedUnit
    opcua: Client

    async def values(self) -> dict[str, Written]:
        """By the lines that the daemon sends its server."""
        await self.nodes.take(self.unit.line())
        await self.nodes.take(self.unit.state_line())
        sigmas = [f"{key}.sigma" for key in KEYS]
        return await read_nodes(self.opcua, *KEYS, *sigmas, "valid", "sequence", "frames", "status", "health")

    async def registers(self, function: int, address: int, count: int) -> bytes:
        reader, writer = self.tcp
        writer.write(struct.pack(">HHHBBHH", 1, 0, 6, 1, function, address, count))
        head = await reader.readexactly(7)
        pdu = await reader.readexactly(struct.unpack(">HHHB", head)[2] - 1)
        assert pdu[0] == function, pdu.hex()
        return pdu[2:]

    async def over_rtu(self, address: int, count: int) -> bytes:
        request = struct.pack(">BBHH", 1, 3, address, count)
        self.rtu.send(request + crc(request))
        length = 5 + 2 * count
        answer = await self.rtu.receive(lambda data: len(data) >= length)
        assert crc(answer[:-2]) == answer[-2:]
        return answer[3:-2]

    async def document(self, path: str) -> dict[str, Any]:
        reader, writer = await asyncio.open_connection("127.0.0.1", self.http)
        writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n".encode())
        head = (await reader.readuntil(b"\r\n\r\n")).decode().lower()
        assert head.startswith("http/1.1 200"), head
        length = int(head.split("content-length: ")[1].split("\r\n")[0])
        content = await reader.readexactly(length)
        writer.transport.abort()
        document: dict[str, Any] = json.loads(content)
        if "crc32" in document:
            checked = content.rstrip(b"\n").rpartition(b', "crc32":')[0]
            assert int(document["crc32"], 16) == zlib.crc32(checked)
        return document

    async def telegram(self) -> list[list[str]]:
        data = await self.nmea.receive(lambda data: b"$PALTC" in data and data.endswith(b"\r\n"))
        telegram = data[data.index(b"$PALTM") :]
        fields = []
        for sentence in telegram.decode("ascii").split():
            body, _, check = sentence[1:].partition("*")
            assert functools.reduce(operator.xor, body.encode()) == int(check, 16)
            fields.append(body.split(","))
        assert [sentence[0] for sentence in fields] == ["PALTM", "PALTQ", "PALTC"]
        return fields


def by_json(document: dict[str, Any]) -> Said:
    time = datetime.fromisoformat(document["time"])
    return Said(
        document["valid"],
        document["sequence"],
        (time - EPOCH) // timedelta(milliseconds=1),
        tuple(document[key] for key in KEYS),
        tuple(document["sigma"][key] for key in KEYS),
        document["frames"],
        frozenset(document["status"]),
        unit=int(document["unit"], 16),
        session=int(document["session"], 16),
    )


def number(value: float) -> float | None:
    return None if math.isnan(value) else value


def by_checked_block(block: bytes) -> Said:
    assert zlib.crc32(block[:-4]) == int.from_bytes(block[-4:])
    state, unit, session = struct.unpack_from(">HII", block, 2)
    sequence, utc_s, utc_ms, frames = struct.unpack_from(">IIHH", block, 24)
    (status,) = struct.unpack_from(">H", block, 40)
    floats = [number(value) for value in struct.unpack_from(">10f", block, 60)]
    values, sigmas = tuple(floats[:4]), tuple(floats[5:9])
    valid = bool(status & 1)
    return Said(valid, sequence, 1000 * utc_s + utc_ms, values, sigmas, frames, None, state, unit, session)


def by_header(block: bytes, first: int, form: str, scale: float, unknown: float) -> Said:
    """By the plain registers, as floating point or as integers."""
    (status,) = struct.unpack_from(">H", block, 0)
    frames, sequence, utc_s, utc_ms = struct.unpack_from(">HIIH", block, 14)
    found = struct.unpack_from(f">11{form}", block, 2 * first)
    known = [None if value == unknown or value != value else value * scale for value in found]
    time_ms = 1000 * utc_s + utc_ms
    return Said(bool(status & 1), sequence, time_ms, tuple(known[:4]), tuple(known[7:11]), frames)


def by_telegram(fields: list[list[str]], day: datetime) -> Said:
    first, second, third = fields
    assert first[3] == second[1]
    clock, date = first[1], third[5]
    time = datetime.strptime(date + clock + "000", "%Y%m%d%H%M%S.%f").replace(tzinfo=UTC)
    values = tuple(float(text) if text else None for text in first[4:8])
    sigmas = tuple(float(text) if text else None for text in second[3:7])
    return Said(
        first[2] in "APS",
        int(first[3]),
        (time - EPOCH) // timedelta(milliseconds=1),
        values,
        sigmas,
        int(second[2]),
        frozenset(filter(None, second[7].split("+"))),
        unit=int(third[1], 16),
        session=int(third[2], 16),
    )


def by_nodes(found: dict[str, Written]) -> Said:
    assert found["sequence"].source is not None
    return Said(
        found["valid"].value,
        found["sequence"].value,
        (found["sequence"].source - EPOCH) // timedelta(milliseconds=1),
        tuple(found[key].value for key in KEYS),
        tuple(found[f"{key}.sigma"].value for key in KEYS),
        found["frames"].value,
        frozenset(found["status"].value),
        found["health"].value,
    )


DIGITS = {
    "opcua": 5e-5,
    "json": 5e-5,
    "checked": 1e-5,
    "plain": 1e-5,
    "scaled": 5.1e-5,
    "rtu": 1e-5,
    "telegram": 5.1e-4,
}
"""The largest error of a value by its number of digits, mm and degrees."""


def differences(truth: Measurement, said: dict[str, Said]) -> Counter[str]:
    """The differences of an interface from the measurement on the board."""
    found: Counter[str] = Counter()
    assert truth.time is not None
    time_ms = (truth.time - EPOCH) // timedelta(milliseconds=1)
    codes = frozenset(map(str, truth.status))
    for name, one in said.items():
        wrong = {
            "valid": one.valid != truth.valid,
            "sequence": one.sequence != truth.sequence % 0xFFFF_FFFF,
            "time": one.time_ms != time_ms,
            "frames": one.frames != truth.frames,
            "reasons": one.reasons is not None and one.reasons != codes and "more" not in one.reasons,
            "values": not same(one.values, [truth.number(key) for key in KEYS], DIGITS[name]),
            "sigmas": not same(one.sigmas, [truth.sigma(key) for key in KEYS], DIGITS[name]),
        }
        found.update(f"{name}: {what}" for what, is_wrong in wrong.items() if is_wrong)
    for what in ("state", "unit", "session"):
        heard = {getattr(one, what) for one in said.values()} - {None}
        found[what] += len(heard) != 1
    return +found


def same(said: tuple[float | None, ...], known: list[float | None], digits: float) -> bool:
    return all(
        (a is None) == (b is None) and (a is None or b is None or abs(a - b) <= digits + 1e-7 * abs(b))
        for a, b in zip(said, known, strict=True)
    )


@pytest.mark.parametrize("rehearsal", [False, True])
async def test_every_interface_says_the_same_of_each_measurement(rehearsal: bool) -> None:
    rng, found, valid = np.random.default_rng(7), Counter[str](), 0
    unit = Unit(rehearsal)
    async with unit.served() as readers:
        await readers.telegram()  # of a unit that has measured nothing
        for count in range(MEASUREMENTS):
            truth = unit.board.publish(drawn(rng, count, unit.clock.now_ns - 500_000_000))
            await unit.clock.advance(INTERVAL_S)
            plain = await readers.registers(4, 0, 120)
            document = await readers.document("/api/measurement")
            said = {
                "json": by_json(document),
                "checked": by_checked_block(await readers.registers(3, 200, 80)),
                "plain": by_header(plain, 20, "f", 1.0, math.nan),
                "scaled": by_header(plain, 60, "i", 1e-4, -(2.0**31)),
                "telegram": by_telegram(await readers.telegram(), unit.clock.utc(0)),
            }
            inputs = (await readers.registers(2, 0, 7))[0]
            assert bool(inputs & 1) == truth.valid
            found_nodes = await readers.values()
            said["opcua"] = by_nodes(found_nodes)
            statuses = {found_nodes[key].status for key in KEYS}
            assert {status.is_bad for status in statuses} == {not truth.valid}
            is_of_cameras = {"playback", "simulated", "rehearsal"}.isdisjoint(map(str, truth.status))
            assert is_of_cameras or Status.GOOD not in statuses
            if count % 5 == 0:
                said["rtu"] = by_checked_block(await readers.over_rtu(200, 80))
                status = await readers.document("/api/status")
                said["json"] = replace(said["json"], state=status["state"]["number"])
            state = said["checked"].state
            assert [inputs >> place & 1 for place in range(1, 5)] == [state == place for place in range(1, 5)]
            is_live = {"playback", "simulated"}.isdisjoint(map(str, truth.status))
            assert is_live or rehearsal or not truth.valid
            assert bool(inputs >> 5 & 1) == (not is_live)
            assert inputs >> 6 == rehearsal
            found += differences(truth, said)
            valid += truth.valid
    assert found == Counter()
    assert 0.2 < valid / MEASUREMENTS < 0.8
