"""Modbus TCP: requests in their MBAP frames, for a few controllers at once, and which of them makes room.

Three quarters of the places belong to the clients that have asked for longest. An address keeps its time when
its connection ends, so that a controller that reconnects is not new. The last quarter goes to new connections
in turn: each gets a place until as many have come after it as there are such places, time enough to ask.

"Messaging" is the Modbus Messaging on TCP/IP Implementation Guide V1.0b.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import math
import socket
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from pymodbus.constants import ExcCodes

from altd.config import ModbusTcpSettings
from altd.publish.modbus.registers import WordOrder
from altd.publish.modbus.responder import WRITE_SINGLE_REGISTER, Responder, command_response
from altd.status.board import Board
from altd.status.health import Component, Health, State
from altd.tcp_port import Networks, accept, address_of, group_of, is_among_last, listen

QUIET_S = 60.0
"""A connection without a request for so long has no claim to its place; a longer gap counts as this one."""

FIRST_REQUEST_S = 5.0
"""A new connection without a request for so long makes room before others."""

KEPT_SHARE = 0.75
MAX_KEPT_OF_ONE_ADDRESS = 8

MAX_REMEMBERED = 1024
"""Addresses whose time is kept when the memory, twice as large, is full."""


@dataclass(slots=True)
class Asking:
    """For how long a client has been asking: the sum of the gaps between its requests, none above a limit."""

    total_s: float = 0.0
    """Until the last request."""
    gap_s: float = 0.0
    """Before the last request."""
    last_s: float | None = None

    def ask(self, now_s: float) -> None:
        """Count a request."""
        if self.last_s is not None:
            self.gap_s = min(now_s - self.last_s, QUIET_S)
            self.total_s += self.gap_s
        self.last_s = now_s

    def until_s(self, now_s: float) -> float:
        """The total until now while the next request is not overdue: slow clients count as fast ones do."""
        return 0.0 if self.last_s is None else self.total_s + min(now_s - self.last_s, self.gap_s)


@dataclass(slots=True, eq=False)
class Connection:
    """A connection since ``since_s``; ``of_address`` is shared by the connections of its address."""

    address: str
    since_s: float
    of_address: Asking
    is_reserved: bool = False
    itself: Asking = field(default_factory=Asking)

    def ask(self, now_s: float) -> None:
        """Count a request."""
        self.itself.ask(now_s)
        self.of_address.ask(now_s)

    def is_quiet(self, now_s: float) -> bool:
        """Whether it has not asked for too long."""
        if self.itself.last_s is None:
            return now_s - self.since_s > FIRST_REQUEST_S
        return now_s - self.itself.last_s > QUIET_S


def connection_to_displace(
    present: Sequence[Connection], newcomer: Connection, now_s: float
) -> Connection | None:
    """The connection that makes room for a newcomer; None: the newcomer gets no place."""
    displaceable = [connection for connection in present if not connection.is_reserved]
    if newcomer.is_reserved and not displaceable:
        displaceable = list(present)
    kept = _kept(displaceable, now_s)
    others = [connection for connection in displaceable if connection not in kept]
    if not others:
        return kept[-1] if newcomer.is_reserved and kept else None
    crowd = Counter(connection.address for connection in others)

    def claim(connection: Connection) -> tuple[bool, int, float]:
        return not connection.is_quiet(now_s), -crowd[connection.address], connection.since_s

    return min(others, key=claim)


def _kept(connections: Sequence[Connection], now_s: float) -> list[Connection]:
    """Three quarters of the connections at most: of those that ask, those of the longest asking addresses."""
    asking = [
        connection
        for connection in connections
        if connection.of_address.last_s is not None and not connection.is_quiet(now_s)
    ]
    asking.sort(key=lambda each: (-each.of_address.until_s(now_s), -each.itself.until_s(now_s), each.since_s))
    kept, of_address = list[Connection](), Counter[str]()
    for connection in asking:
        of_address[connection.address] += 1
        if of_address[connection.address] <= MAX_KEPT_OF_ONE_ADDRESS:
            kept.append(connection)
    return kept[: math.ceil(len(connections) * KEPT_SHARE)]


class Addresses:
    """For how long each address has been asking, in a bounded memory."""

    def __init__(self) -> None:
        self._asking: dict[str, Asking] = {}

    def __len__(self) -> int:
        return len(self._asking)

    def asking(self, address: str) -> Asking:
        """The record of an address, which its connections share."""
        if address not in self._asking:
            if len(self._asking) >= 2 * MAX_REMEMBERED:
                self._forget()
            self._asking[address] = Asking()
        return self._asking[address]

    def _forget(self) -> None:
        by_time = sorted(self._asking.items(), key=lambda item: (item[1].total_s, item[1].last_s or 0.0))
        self._asking = dict(by_time[-MAX_REMEMBERED:])


MBAP = struct.Struct(">HHHB")
"""Transaction, protocol (0), bytes that follow the length, unit (Messaging 3.1.3)."""

MAX_LENGTH = 254
"""The largest length field: the unit and a protocol data unit of 253 bytes."""

MAX_CLIENTS = 32
"""With more, one is closed (Messaging 4.2); ``places`` chooses it."""

ACCEPT_INTERVAL_S = 0.001
"""Between two connections: a flood of them gets a part of the loop's time, and requests have the rest."""

RESERVED_DESCRIPTORS = 4
"""Where the process may have few descriptors, so many are left to cameras and ports."""

_DIRECT = frozenset({0, 255})
"""Unit ids for the device itself, not for something behind a gateway (Messaging 4.4.1.2)."""

READ_AHEAD_BYTES = 1024
"""While more than twice as many bytes wait for their answers, nothing more is read from a client."""


class ModbusTcpPublisher:
    """Serves board and health over Modbus TCP; takes self-checks that controllers may ask for."""

    def __init__(
        self,
        settings: ModbusTcpSettings,
        board: Board,
        component: Component,
        health: Health,
    ) -> None:
        self._settings = settings
        self._service = health.self_check if settings.allow_self_check else None
        self._responder = Responder(board, component, health, WordOrder(settings.word_order))
        self._component = component
        self._clients: dict[Connection, asyncio.Task[None]] = {}
        self._addresses = Addresses()
        self._reserved = Networks(settings.reserved)
        self._response_turn = asyncio.Lock()
        """One answer a turn of the loop, whoever asks: no crowd of clients holds the rest of the unit up."""
        self.port = settings.port
        """The port that is served; it differs from the setting when that is 0, once it listens."""

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError when the address cannot be had."""
        with listen(self._settings.host, self._settings.port) as listener:
            _detect_dead_peers(listener)
            self.port = listener.getsockname()[1]
            async with asyncio.TaskGroup() as clients:
                ready()
                self._component.set_state(State.OK, f"Modbus TCP on port {self.port}")
                admit = functools.partial(self._admit, clients)
                await accept(listener, self._component, admit, ACCEPT_INTERVAL_S)

    async def _admit(self, tasks: asyncio.TaskGroup, connection: socket.socket) -> None:
        """Serve a connection; where there are enough, another one makes room, or it is closed."""
        loop = asyncio.get_running_loop()
        client = self._client(connection.getpeername()[0], loop.time())
        if len(self._clients) >= MAX_CLIENTS or is_among_last(connection, RESERVED_DESCRIPTORS):
            displaced = connection_to_displace(list(self._clients), client, loop.time())
            if displaced is None:
                self._component.count("connections_refused")
                connection.close()
                return
            self._component.count("clients_displaced")
            self._clients.pop(displaced).cancel()

        def begin(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            serving = tasks.create_task(self._serve(client, reader, writer), name="modbus tcp client")
            serving.add_done_callback(lambda _: self._dismiss(client, writer))
            self._clients[client] = serving
            self._component.count("clients")

        streams = asyncio.StreamReaderProtocol(asyncio.StreamReader(READ_AHEAD_BYTES), begin)
        await loop.connect_accepted_socket(lambda: streams, connection)

    def _client(self, host: str, now_s: float) -> Connection:
        address = address_of(host)
        group = host if address is None else group_of(address)
        return Connection(group, now_s, self._addresses.asking(group), address in self._reserved)

    def _dismiss(self, client: Connection, writer: asyncio.StreamWriter) -> None:
        self._clients.pop(client, None)
        self._component.count("clients", -1)
        writer.transport.abort()

    async def _serve(
        self, client: Connection, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Answer one client until it leaves or stops making sense."""
        clock = asyncio.get_running_loop().time
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):  # it left
            while True:
                transaction, protocol, length, unit = MBAP.unpack(await reader.readexactly(MBAP.size))
                if protocol != 0 or not 2 <= length <= MAX_LENGTH:
                    self._component.count("garbled")  # where the next frame begins cannot be known
                    return
                request = await reader.readexactly(length - 1)
                async with self._response_turn:
                    answer = self._answer(unit, request)
                    client.ask(clock())
                    writer.write(MBAP.pack(transaction, 0, len(answer) + 1, unit) + answer)
                    await asyncio.sleep(0)
                await writer.drain()

    def _answer(self, unit: int, request: bytes) -> bytes:
        if unit == self._settings.unit_id or unit in _DIRECT:
            if self._service is not None and request[0] == WRITE_SINGLE_REGISTER:
                self._component.count("commands")
                return command_response(request, self._service)
            return self._responder.answer(request)
        self._component.count("other_units")
        return bytes([request[0] | 0x80, ExcCodes.GATEWAY_NO_RESPONSE])


def _detect_dead_peers(listener: socket.socket) -> None:
    """Have the kernel end a connection whose other end has been gone for a minute (Messaging 4.3.2)."""
    # what is set here every accepted connection inherits
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 30)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 10)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
