"""Readers of every interface, as independent clients have them: what each one publishes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import struct
from collections.abc import AsyncIterator, Awaitable, Iterable
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import aiomqtt
import numpy as np

from altd.records import FloatArray
from altd.telegram import Reader, Reading
from benchmarks.interfaces import HOST, Interfaces
from benchmarks.poller import ANSWER_BYTES, READ
from benchmarks.wire_errors.polled import raw_terminal

KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
DAY = date(2026, 11, 20)
"""Of every run, which lasts less: a telegram has a time and no date."""
_TIMEOUT_S = 5.0
_ORIGINS = ("rehearsal", "simulated", "calibration_simulated")
"""Warnings that every measurement of this suite has: no reason why one is invalid."""


@dataclass(frozen=True, slots=True)
class Published:
    """What an interface shows: the numbers (None: it shows none), as of ``utc``, and why there are none."""

    wire: str
    values: FloatArray | None
    sigma: FloatArray | None
    utc: datetime | None
    reasons: tuple[str, ...]
    frames: int = 0
    """Exposures averaged."""
    age_s: float | None = None
    contradicts: bool = False
    """It is marked invalid and has numbers, or valid and lacks one."""


def of_json(wire: str, text: bytes | str) -> Published:
    """A measurement of HTTP, the local socket or MQTT. Any number counts, whatever ``valid`` says."""
    told = json.loads(text)
    numbers = [told.get(key) for key in KEYS]
    has_all = None not in numbers
    sigma = told.get("sigma") or {}
    utc = told.get("time")
    return Published(
        wire,
        np.array(numbers, np.float64) if has_all else None,
        np.array([sigma.get(key) or np.nan for key in KEYS]) if has_all else None,
        None if utc is None else datetime.fromisoformat(utc),
        _reasons(told["status"]),
        told["frames"],
        None if wire == "mqtt" else told["age_s"],  # it may wait for its broker while the clock is set
        contradicts=len({bool(told["valid"]), has_all, any(n is not None for n in numbers)}) > 1,
    )


def _reasons(status: Iterable[str]) -> tuple[str, ...]:
    return tuple(reason for reason in status if reason not in _ORIGINS)


def of_registers(registers: bytes) -> Published:
    """The header and the values of a Modbus answer from address 0 (``docs/modbus.md``)."""
    status, *_ = struct.unpack_from(">H", registers)
    reasons = struct.unpack_from(">3H", registers, 4)
    age_ms, frames = struct.unpack_from(">HH", registers, 12)
    utc_s, utc_ms = struct.unpack_from(">IH", registers, 20)
    values = np.array(struct.unpack_from(">4f", registers, 40), np.float64)
    sigma = np.array(struct.unpack_from(">4f", registers, 68), np.float64)
    known = np.isfinite(values)
    is_known = utc_s != 0xFFFF_FFFF
    return Published(
        "modbus",
        values if known.all() else None,
        sigma if known.all() else None,
        datetime.fromtimestamp(utc_s, UTC) + timedelta(milliseconds=utc_ms) if is_known else None,
        tuple(str(reason) for reason in reasons if reason),
        frames,
        None if age_ms == 0xFFFF else age_ms * 1e-3,
        contradicts=len({bool(status & 1), bool(known.all()), bool(known.any())}) > 1,
    )


class TelegramLine:
    """The reader of the telegram, on a port that can be unplugged; ``device`` is the unit's end."""

    def __init__(self, device: Path) -> None:
        self.device = device
        self.is_read = True
        self._ends = (-1, -1)
        self.plug()

    @property
    def line(self) -> int:
        """The far end, for who disturbs it; -1: it is unplugged."""
        return self._ends[0]

    def plug(self) -> None:
        """Let the port be there."""
        self._ends = raw_terminal()
        os.set_blocking(self.line, False)
        self.device.symlink_to(os.ttyname(self._ends[1]))
        self._reader = Reader()

    def unplug(self) -> None:
        """Pull the cable."""
        self.device.unlink()
        for end in self._ends:
            os.close(end)
        self._ends = (-1, -1)

    def close(self) -> None:
        """Release the port."""
        if self.line >= 0:
            self.unplug()

    def restart(self) -> None:
        """Read again, with an empty buffer as ``docs/telegram.md`` demands."""
        with contextlib.suppress(BlockingIOError):
            while True:
                os.read(self.line, 65536)
        self._reader, self.is_read = Reader(), True

    def read(self) -> list[Published]:
        """What has come."""
        if not self.is_read or self.line < 0:
            return []
        data = b""
        with contextlib.suppress(BlockingIOError):
            data = os.read(self.line, 65536)
        return [self._published(reading) for reading in self._reader.feed(data)]

    def _published(self, reading: Reading) -> Published:
        numbers = [getattr(reading, key) for key in KEYS]
        has_all = None not in numbers
        utc = None if reading.time is None else datetime.combine(DAY, reading.time, UTC)
        return Published(
            "telegram",
            np.array(numbers, np.float64) if has_all else None,
            np.array([getattr(reading, f"sigma_{key}") or np.nan for key in KEYS]) if has_all else None,
            utc,
            _reasons(reading.reasons) or ((reading.fault,) if reading.fault else ()),
            reading.frames or 0,
            contradicts=len({reading.mode != "V" and not reading.fault, has_all, any(n is not None for n in numbers)}) > 1,
        )


Link = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class Wires:
    """One client of each interface. ``read`` returns what all show now, and what has come since.

    HTTP answers once on a connection, Modbus keeps it.
    """

    def __init__(self, places: Interfaces, telegram: TelegramLine, socket: Path) -> None:
        self.telegram = telegram
        self.came: list[Published] = []
        self._places = places
        self._socket = socket
        self._modbus: Link | None = None
        self._beside: Link | None = None

    @property
    def serial_lines(self) -> list[int]:
        """The far ends of the serial lines: of the telegram, and of Modbus RTU."""
        return [line for line in (self.telegram.line, *self._places.rtu) if line >= 0]

    def reset(self) -> None:
        """Reset every connection; the next request makes it anew."""
        for link in (self._modbus, self._beside):
            if link is not None:
                end = link[1].get_extra_info("socket")
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                link[1].transport.abort()
        self._modbus = self._beside = None

    async def read(self) -> list[Published]:
        """Ask HTTP, the local socket and Modbus; take what telegram and MQTT have sent."""
        async with asyncio.timeout(_TIMEOUT_S):
            shown = await asyncio.gather(
                _get("http", asyncio.open_connection(HOST, self._places.http_port)),
                _get("local", asyncio.open_unix_connection(self._socket)),
                self._poll(),
            )
        came, self.came = self.came, []
        return [*shown, *self.telegram.read(), *came]

    async def _poll(self) -> Published:
        if self._modbus is None:
            self._modbus = await asyncio.open_connection(HOST, self._places.modbus_port)
        reader, writer = self._modbus
        writer.write(READ)
        answer = await reader.readexactly(ANSWER_BYTES)
        return of_registers(answer[9:])

    async def ask_again(self, copies: int) -> None:
        """Send each request so many times at once on another connection; what is answered counts too."""
        if self._beside is None:
            self._beside = await asyncio.open_connection(HOST, self._places.modbus_port)
        reader, writer = self._beside
        writer.write(READ * copies)
        async with asyncio.timeout(_TIMEOUT_S):
            answers = await reader.readexactly(ANSWER_BYTES * copies)
        self.came += [
            of_registers(answers[at + 9 : at + ANSWER_BYTES]) for at in range(0, len(answers), ANSWER_BYTES)
        ]


@contextlib.asynccontextmanager
async def wires_of(
    places: Interfaces, telegram: TelegramLine, socket: Path, has_broker: bool
) -> AsyncIterator[Wires]:
    """Clients of all interfaces; without a broker none of MQTT."""
    wires = Wires(places, telegram, socket)
    async with contextlib.AsyncExitStack() as parts:
        parts.callback(wires.reset)
        if has_broker:
            client = aiomqtt.Client(HOST, places.mqtt_port, protocol=aiomqtt.ProtocolVersion.V5)
            await parts.enter_async_context(client)
            await client.subscribe("altd/+/measurement", qos=1)
            parts.push_async_callback(_end, asyncio.create_task(_listen(client, wires)))
        yield wires


async def _get(wire: str, connecting: Awaitable[Link]) -> Published:
    reader, writer = await connecting
    try:
        writer.write(b"GET /api/v1/measurement HTTP/1.1\r\nHost: localhost\r\n\r\n")
        head, _, body = (await reader.read(-1)).partition(b"\r\n\r\n")
    finally:
        writer.close()
    if head.startswith(b"HTTP/1.1 503"):  # before the first measurement
        return Published(wire, None, None, None, ("unavailable",))
    if not head.startswith(b"HTTP/1.1 200"):
        raise ConnectionError(head.decode())
    return of_json(wire, body)


async def _listen(client: aiomqtt.Client, wires: Wires) -> None:
    async for message in client.messages:
        if message.payload:
            wires.came.append(of_json("mqtt", bytes(message.payload)))  # type: ignore[arg-type]


async def _end(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
