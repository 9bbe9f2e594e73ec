"""Modbus TCP: requests in their MBAP frames, for a few controllers at once.

"Messaging" is the Modbus Messaging on TCP/IP Implementation Guide V1.0b.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import socket
import struct
from collections.abc import Callable

from pymodbus.constants import ExcCodes

from altd.config import ModbusTcpSettings
from altd.publish.modbus.commands import WRITE_SINGLE_REGISTER, command_response
from altd.publish.modbus.places import Addresses, Connection, connection_to_displace
from altd.publish.modbus.responder import Responder
from altd.status.board import Board
from altd.status.cause import StateReport
from altd.status.health import Component, State
from altd.status.self_check_desk import SelfCheckDesk
from altd.tcp_port.accepting import accept, is_among_last, listen
from altd.tcp_port.addresses import Networks, address_of, group_of

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
    """Serves the board over Modbus TCP. A self-check is asked for at ``desk`` where the settings allow it."""

    def __init__(
        self,
        settings: ModbusTcpSettings,
        board: Board,
        component: Component,
        desk: SelfCheckDesk | None = None,
        state: Callable[[], StateReport | None] = lambda: None,
    ) -> None:
        self._settings = settings
        self._desk = desk if settings.allow_self_check else None
        self._responder = Responder(board, component, state)
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
                    answer = await self._answer(unit, request)
                    client.ask(clock())
                    writer.write(MBAP.pack(transaction, 0, len(answer) + 1, unit) + answer)
                    await asyncio.sleep(0)
                await writer.drain()

    async def _answer(self, unit: int, request: bytes) -> bytes:
        if unit == self._settings.unit_id or unit in _DIRECT:
            if self._desk is not None and request[0] == WRITE_SINGLE_REGISTER:
                self._component.count("commands")
                return command_response(request, self._desk)
            return await self._responder.answer(request)
        self._component.count("other_units")
        return bytes([request[0] | 0x80, ExcCodes.GATEWAY_NO_RESPONSE])


def _detect_dead_peers(listener: socket.socket) -> None:
    """Have the kernel end a connection whose other end has been gone for a minute (Messaging 4.3.2)."""
    # what is set here every accepted connection inherits
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 30)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 10)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
