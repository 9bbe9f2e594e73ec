"""Readers of every interface, written as independent clients, and the published content."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import socket
import struct
from collections.abc import AsyncIterator, Awaitable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path

import aiomqtt
import numpy as np

from altd.records import FloatArray
from benchmarks.harness import HOST, KEYS
from benchmarks.interfaces import Interfaces, raw_terminal
from benchmarks.poller import ANSWER_BYTES, READ
from examples.python.altd_telegram import Reader, Reading

DAY = date(2026, 11, 20)
"""Date of every run, which is shorter than a day: a telegram has a time and no date."""
_ORIGINS = ("rehearsal", "simulated", "calibration_simulated")
"""Warnings of every measurement of this suite; they are not reasons for an invalid one."""


@dataclass(frozen=True, slots=True)
class Published:
    """Content of one answer or message: values at ``utc``, or the reasons for having none.

    ``contradicts``: it is marked invalid and has a value, or valid and lacks one. ``frames`` were averaged.
    """

    wire: str
    values: FloatArray | None = None
    sigma: FloatArray | None = None
    utc: datetime | None = None
    reasons: tuple[str, ...] = ()
    frames: int = 0
    age_s: float | None = None
    contradicts: bool = False

    @classmethod
    def of(  # noqa: PLR0913  fields of the message
        cls,
        wire: str,
        valid: bool,
        numbers: Sequence[float | None],
        sigmas: Sequence[float | None],
        utc: datetime | None,
        reasons: Iterable[str],
        frames: int,
        age_s: float | None = None,
    ) -> Published:
        """Make it from its fields; values count regardless of ``valid``, an unknown sigma is NaN."""
        known = {number is not None for number in numbers}
        return cls(
            wire,
            np.array(numbers, np.float64) if known == {True} else None,
            np.array([sigma or np.nan for sigma in sigmas], np.float64) if known == {True} else None,
            utc,
            tuple(reason for reason in reasons if reason not in _ORIGINS),
            frames,
            age_s,
            contradicts=known != {valid},
        )


def of_json(wire: str, text: bytes) -> Published:
    """Parse a measurement of HTTP, the local socket or MQTT (``docs/http.md``)."""
    told = json.loads(text)
    numbers, sigmas = ([of.get(key) for key in KEYS] for of in (told, told["sigma"]))
    utc = None if told["time"] is None else datetime.fromisoformat(told["time"])
    return Published.of(
        wire, told["valid"], numbers, sigmas, utc, told["status"], told["frames"], told["age_s"]
    )


def of_registers(registers: bytes) -> Published:
    """Parse the header and the values of a Modbus answer from address 0 (``docs/modbus.md``)."""
    status, *reasons = struct.unpack_from(">H2x3H", registers)
    age_ms, frames = struct.unpack_from(">HH", registers, 12)
    utc_s, utc_ms = struct.unpack_from(">IH", registers, 20)
    utc = None if utc_s == 0xFFFF_FFFF else datetime.fromtimestamp(utc_s + utc_ms * 1e-3, UTC)
    numbers, sigmas = (
        [value if math.isfinite(value) else None for value in struct.unpack_from(">4f", registers, at)]
        for at in (40, 68)
    )
    codes = [f"reason {reason}" for reason in reasons if reason]
    age_s = None if age_ms == 0xFFFF else age_ms * 1e-3
    return Published.of("modbus", bool(status & 1), numbers, sigmas, utc, codes, frames, age_s)


def of_telegram(reading: Reading) -> Published:
    """Convert a telegram of any mode; a refused telegram has no values."""
    numbers, sigmas = ([getattr(reading, before + key) for key in KEYS] for before in ("", "sigma_"))
    utc = None if reading.time is None else datetime.combine(DAY, reading.time, UTC)
    valid = reading.mode != "V" and not reading.fault
    reasons = [*reading.reasons, *([reading.fault] if reading.fault else [])]
    return Published.of("telegram", valid, numbers, sigmas, utc, reasons, reading.frames or 0)


class TelegramLine:
    """Reader of the telegram, on a port that can be unplugged; ``device`` is the unit's end."""

    def __init__(self, device: Path) -> None:
        self.device = device
        self.is_read = True
        self._ends = (-1, -1)
        self.plug()

    @property
    def line(self) -> int:
        """Descriptor of the far end; -1 if unplugged."""
        return self._ends[0]

    def plug(self) -> None:
        """Plug the port in."""
        self._ends = raw_terminal()
        os.set_blocking(self.line, False)
        self.device.symlink_to(os.ttyname(self._ends[1]))
        self._reader = Reader()

    def unplug(self) -> None:
        """Unplug the cable."""
        self.device.unlink()
        for end in self._ends:
            os.close(end)
        self._ends = (-1, -1)

    def close(self) -> None:
        """Release the port."""
        if self.line >= 0:
            self.unplug()

    def stop(self) -> None:
        """Stop reading."""
        self.is_read = False

    def restart(self) -> None:
        """Restart reading, with an empty buffer as ``docs/telegram.md`` requires."""
        with contextlib.suppress(BlockingIOError):
            while True:
                os.read(self.line, 65536)
        self._reader, self.is_read = Reader(), True

    def read(self) -> list[Published]:
        """Telegrams received since the last call."""
        if not self.is_read or self.line < 0:
            return []
        data = b""
        with contextlib.suppress(BlockingIOError):
            data = os.read(self.line, 65536)
        return [of_telegram(reading) for reading in self._reader.feed(data)]


Link = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class Wires:
    """One client of each interface. ``read`` returns their current and newly received messages.

    HTTP uses a new connection for each request, Modbus keeps its connection.
    """

    def __init__(
        self, places: Interfaces, telegram: TelegramLine, socket: Path, within_s: float = 5.0
    ) -> None:
        self.telegram = telegram
        self._within_s = within_s
        self.came: list[Published] = []
        self._places = places
        self._socket = socket
        self._modbus: Link | None = None
        self._beside: Link | None = None

    @property
    def serial_lines(self) -> list[int]:
        """Far ends of the serial lines of the telegram and of Modbus RTU."""
        return [line for line in (self.telegram.line, *self._places.rtu) if line >= 0]

    def reset(self) -> None:
        """Reset every connection; the next request makes a new one."""
        for link in (self._modbus, self._beside):
            if link is not None and not link[1].transport.is_closing():
                end = link[1].get_extra_info("socket")
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                link[1].transport.abort()
        self._modbus = self._beside = None

    async def read(self) -> list[Published]:
        """Poll HTTP, the local socket and Modbus; take received telegrams and MQTT messages."""
        asked = (
            _get("http", asyncio.open_connection(HOST, self._places.http_port)),
            _get("local", asyncio.open_unix_connection(self._socket)),
            self._poll(),
        )
        shown = [answer for ask in asked if (answer := await self._answered(ask)) is not None]
        came, self.came = self.came, []
        return [*shown, *self.telegram.read(), *came]

    async def _answered(self, ask: Awaitable[Published]) -> Published | None:
        """Return an answer; None, after a reset of the connections, if there is none in time."""
        try:
            async with asyncio.timeout(self._within_s):
                return await ask
        except (OSError, TimeoutError, asyncio.IncompleteReadError):
            self.reset()
            return None

    async def _poll(self) -> Published:
        if self._modbus is None:
            self._modbus = await asyncio.open_connection(HOST, self._places.modbus_port)
        reader, writer = self._modbus
        writer.write(READ)
        answer = await reader.readexactly(ANSWER_BYTES)
        return of_registers(answer[9:])

    async def ask_again(self, copies: int) -> None:
        """Send each request ``copies`` times at once on another connection; the answers count too."""
        if self._beside is None:
            self._beside = await asyncio.open_connection(HOST, self._places.modbus_port)
        reader, writer = self._beside
        writer.write(READ * copies)
        async with asyncio.timeout(self._within_s):
            answers = await reader.readexactly(ANSWER_BYTES * copies)
        self.came += [
            of_registers(answers[at + 9 : at + ANSWER_BYTES]) for at in range(0, len(answers), ANSWER_BYTES)
        ]


@contextlib.asynccontextmanager
async def wires_of(
    places: Interfaces, telegram: TelegramLine, socket: Path, has_broker: bool
) -> AsyncIterator[Wires]:
    """Clients of all interfaces; without a broker there is none for MQTT."""
    wires = Wires(places, telegram, socket)
    for line in places.rtu:  # a full line would also stop the unit, which runs in this process
        os.set_blocking(line, False)
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
        return Published(wire, reasons=("unavailable",))
    if not head.startswith(b"HTTP/1.1 200"):
        raise ConnectionError(head.decode())
    return of_json(wire, body)


async def _listen(client: aiomqtt.Client, wires: Wires) -> None:
    async for message in client.messages:
        if message.payload:
            wires.came.append(of_json("mqtt", bytes(message.payload)))


async def _end(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
