"""A broker whose answers a test chooses, Debian's mosquitto, and a unit that publishes to either."""

import asyncio
import contextlib
import os
import random
import signal
import socket
import subprocess
import time
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

from altd.config import MqttSettings
from altd.history.outbox import Outbox
from altd.instruments.beam.instrument import QUANTITIES
from altd.ports import Clock
from altd.publish.mqtt.edge_node import EdgeNodePublisher
from altd.publish.mqtt.publisher import MqttPublisher
from altd.runtime.clock import SystemClock
from altd.runtime.supervision import keep_running
from altd.status.board import Board
from altd.status.health import Component, Health, State
from altd.status.proof import Identity
from altd.status.state import UnitState
from altd.status.unit import PublishedUnit, UnitFacts
from support.foreign import need_program
from support.ports import free_port
from support.tcp_server import TcpServer
from tools.pages.example import MEASURED, SERIAL

CONNECTED = bytes.fromhex("20 03 00 00 00")
CONNECT, PUBLISH, SUBSCRIBE, PINGREQ, DISCONNECT = 1, 3, 8, 12, 14


class Published(NamedTuple):
    """A message as a broker takes it."""

    topic: str
    data: bytes
    qos: int
    retain: bool
    expiry_s: int | None

    @property
    def payload(self) -> str:
        return self.data.decode()


@dataclass
class ChosenBroker:
    """A broker on a free port. ``greeting`` answers CONNECT, ``answer`` each message by its number."""

    greeting: bytes = CONNECTED
    granted: int = 1
    """The reason code that a subscription is answered with."""
    answer: Callable[[int], bytes] = lambda number: b"\x40\x02" + number.to_bytes(2)
    port: int = 0
    published: asyncio.Queue[Published] = field(default_factory=asyncio.Queue)
    begins: asyncio.Queue[None] = field(default_factory=asyncio.Queue)
    """One entry for each connection."""
    ends: asyncio.Queue[int] = field(default_factory=asyncio.Queue)
    """The last packet of each connection that has ended, by its type."""
    answers_pings: bool = True
    wills: list[tuple[int, bool]] = field(default_factory=list)
    """QoS and retain of the will of each connection."""
    connects: list[bytes] = field(default_factory=list)
    """The body of each CONNECT."""
    pings: asyncio.Queue[None] = field(default_factory=asyncio.Queue)
    _writer: asyncio.StreamWriter | None = None

    async def __aenter__(self) -> Self:
        self._server = await TcpServer(self._serve, self.port).__aenter__()
        self.port = self._server.port
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._server.__aexit__()

    async def until(self, topic: str) -> Published:
        """The next message on a topic that ends so."""
        while not (message := await asyncio.wait_for(self.published.get(), 10.0)).topic.endswith(topic):
            pass
        return message

    def tell(self, data: bytes) -> None:
        """Send bytes over the newest connection."""
        self._writer.write(data)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.begins.put_nowait(None)
        kind = 0
        try:
            while True:
                kind, flags, body = await packet_of(reader)
                if kind == CONNECT:
                    self._writer = writer
                    self.wills.append((body[7] >> 3 & 3, bool(body[7] & 0x20)))
                    self.connects.append(body)
                    writer.write(self.greeting)
                elif kind == PUBLISH:
                    number, message = published(flags, body)
                    self.published.put_nowait(message)
                    if message.qos:
                        writer.write(self.answer(number))
                elif kind == SUBSCRIBE:
                    writer.write(b"\x90\x04" + body[:2] + bytes([0, self.granted]))
                elif kind == PINGREQ:
                    self.pings.put_nowait(None)
                    writer.write(b"\xd0\x00" * self.answers_pings)
        finally:
            self.ends.put_nowait(kind)


async def packet_of(reader: asyncio.StreamReader) -> tuple[int, int, bytes]:
    first = (await reader.readexactly(1))[0]
    length, shift = 0, 0
    while True:
        byte = (await reader.readexactly(1))[0]
        length |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return first >> 4, first & 15, await reader.readexactly(length)


async def packets_of(stream: bytes) -> list[tuple[int, int, bytes]]:
    """The packets in what a client has sent: type, flags, body."""
    reader = asyncio.StreamReader()
    reader.feed_data(stream)
    reader.feed_eof()
    packets = []
    with contextlib.suppress(asyncio.IncompleteReadError):
        while True:
            packets.append(await packet_of(reader))
    return packets


def published(flags: int, body: bytes) -> tuple[int, Published]:
    """The number of a message, 0 with QoS 0, and the message."""
    end, qos = 2 + int.from_bytes(body[:2]), flags >> 1 & 3
    topic, rest = body[2:end].decode(), body[end:]
    number, rest = (int.from_bytes(rest[:2]), rest[2:]) if qos else (0, rest)
    properties, data = rest[1 : 1 + rest[0]], rest[1 + rest[0] :]
    expiry_s = int.from_bytes(properties[1:5]) if properties[:1] == b"\x02" else None
    return number, Published(topic, data, qos, bool(flags & 1), expiry_s)


@dataclass
class PublishingUnit:
    """A unit's board, and what publishes it."""

    board: Board
    health: Health
    component: Component
    publisher: MqttPublisher | EdgeNodePublisher
    clock: Clock

    @classmethod
    def made(
        cls,
        port: int,
        clock: Clock | None = None,
        serial: str = SERIAL,
        outbox: Outbox | None = None,
        **settings: Any,
    ) -> Self:
        clock = clock or SystemClock()
        health, board = Health(clock), Board(clock, 10.0, QUANTITIES, Identity.drawn(serial))
        facts, state = UnitFacts(serial=serial, version="0.1.0"), UnitState(board, health, clock)
        unit = PublishedUnit(board, health, facts, state=state.read)
        component = health.component("mqtt")
        mqtt = MqttSettings(**{"host": "127.0.0.1", "port": port} | settings)
        about = (mqtt, unit, component, random.Random(1))
        publisher = EdgeNodePublisher(*about) if mqtt.sparkplug else MqttPublisher(*about, outbox)
        return cls(board, health, component, publisher, clock)

    def measure(self, sequence: int, **changes: Any) -> None:
        """Put a measurement of half a second ago on the board."""
        now_ns = self.clock.monotonic_ns()
        made = replace(MEASURED, sequence=sequence, t_ns=now_ns - 500_000_000, last_exposure_ns=now_ns)
        self.board.publish(replace(made, **changes))

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[asyncio.Task[None]]:
        """Under supervision, as in the daemon."""
        task = asyncio.create_task(keep_running("mqtt", self.publisher, self.component, self.clock))
        try:
            yield task
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def until(self, state: State, words: str = "", within_s: float = 20.0) -> str:
        """Wait until the component is so; returns its sentence."""
        deadline_s = time.monotonic() + within_s
        while self.component.state is not state or words not in self.component.message:
            assert time.monotonic() < deadline_s, f"{self.component.state}: {self.component.message}"
            await asyncio.sleep(0.005)
        return self.component.message


@contextlib.contextmanager
def mosquitto(folder: Path, *lines: str, port: int = 0) -> Iterator[tuple[int, subprocess.Popen[bytes]]]:
    """Debian's mosquitto with these lines in its configuration; its port and its process."""
    port = port or free_port()
    config = folder / f"mosquitto-{port}.conf"
    user = ["user root"] if os.getuid() == 0 else []  # the test's files are root's
    config.write_text("\n".join([*user, f"listener {port} 127.0.0.1", *lines]) + "\n")
    program = need_program("mosquitto")
    with (folder / "mosquitto.log").open("ab") as log:
        broker = subprocess.Popen([program, "-c", str(config)], stdout=log, stderr=log)
    while not _listens(port):
        assert broker.poll() is None, (folder / "mosquitto.log").read_text()
        time.sleep(0.005)
    try:
        yield port, broker
    finally:
        broker.send_signal(signal.SIGTERM)
        broker.wait()


def _listens(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
        return True
    return False


_OWN_LINES = ("Client ", "Subscribed ")
"""First words of what ``mosquitto_sub -d`` prints about itself."""


class Subscriber:
    """mosquitto_sub, a foreign client; each message as a line: topic, QoS, retained, payload."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self._queued: list[str] = []

    async def next(self, topic: str = "", timeout_s: float = 20.0) -> tuple[str, int, bool, str]:
        """The next message whose topic ends so."""
        async with asyncio.timeout(timeout_s):
            while line := self._queued.pop(0) if self._queued else await self._line():
                if line.startswith(_OWN_LINES):
                    continue
                name, qos, retained, payload = line.rstrip("\n").split(" ", 3)
                if name.endswith(topic):
                    return name, int(qos), retained == "1", payload
        raise AssertionError("mosquitto_sub has ended")

    async def subscription(self) -> None:
        """Return once the broker has it, or has refused: earlier messages would be lost."""
        async with asyncio.timeout(20.0):
            while line := await self._line():
                if line.startswith("Subscribed"):
                    return
                self._queued.append(line)  # of a session that the broker keeps

    async def _line(self) -> str:
        return (await self._process.stdout.readline()).decode()

    async def all(self) -> list[tuple[str, int, bool, str]]:
        """All messages until it ends."""
        messages = []
        with contextlib.suppress(AssertionError):
            while True:
                messages.append(await self.next())
        return messages


@contextlib.asynccontextmanager
async def subscribed(port: int, *arguments: str, topic: str = "altd/#") -> AsyncIterator[Subscriber]:
    """mosquitto_sub at a broker; further ``arguments`` as it takes them."""
    program = need_program("mosquitto_sub", "mosquitto-clients")
    line = ["-d", "-V", "5", "-p", str(port), "-q", "1", "-t", topic, "-F", "%t %q %r %p", *arguments]
    command = "stdbuf", "-oL", program, *line
    process = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.PIPE)
    try:
        subscriber = Subscriber(process)
        await subscriber.subscription()
        yield subscriber
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


class Valve(TcpServer):
    """A way to a broker that can stop reading what the unit sends.

    ``sent`` has what each connection has sent to the broker.
    """

    def __init__(self, port: int) -> None:
        super().__init__(self._join, limit=1024)
        self._to = port
        self.sent: list[bytearray] = []
        self.open = asyncio.Event()
        self.open.set()

    async def _join(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        back, forth = await asyncio.open_connection("127.0.0.1", self._to)
        self.sent.append(bytearray())
        with contextlib.closing(forth):
            await asyncio.gather(self._flow(reader, forth, self.sent[-1]), self._flow(back, writer))

    async def _flow(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, kept: bytearray | None = None
    ) -> None:
        while piece := await reader.read(1024):
            await self.open.wait()
            if kept is not None:
                kept += piece
            writer.write(piece)
            await writer.drain()
        writer.close()
