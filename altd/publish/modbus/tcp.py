"""Modbus TCP: requests in their MBAP frames, for a few controllers at once.

"Messaging" is the Modbus Messaging on TCP/IP Implementation Guide V1.0b.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
from collections.abc import Callable

from pymodbus.constants import ExcCodes

from altd.config import ModbusTcp
from altd.publish.modbus.responder import Responder
from altd.service.board import Board
from altd.service.health import Component, State

MBAP = struct.Struct(">HHHB")
"""Transaction, protocol (0), bytes that follow the length, unit (Messaging 3.1.3)."""

LONGEST = 254
"""The largest length field: the unit and a protocol data unit of 253 bytes."""

MAX_CLIENTS = 32
"""With more, the one that has been quiet for longest is closed (Messaging 4.2): connections that a controller
has forgotten make room for it."""

_DIRECT = frozenset({0, 255})
"""Unit ids for the device itself, not for something behind a gateway (Messaging 4.4.1.2)."""

READ_AHEAD = 1024
"""While more than twice as many bytes wait for their answers, nothing more is read from a client."""


class ModbusTcpPublisher:
    """Serves the board over Modbus TCP."""

    def __init__(self, settings: ModbusTcp, board: Board, component: Component) -> None:
        self._settings = settings
        self._responder = Responder(board, component)
        self._component = component
        self._clients: dict[asyncio.StreamWriter, asyncio.Task[None]] = {}
        self.port = settings.port
        """The port that is served; it differs from the setting when that is 0, once it listens."""

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError when the address cannot be had."""
        server = await asyncio.start_server(
            lambda reader, writer: self._admit(clients, reader, writer),
            self._settings.host,
            self._settings.port,
            limit=READ_AHEAD,
            start_serving=False,
        )
        async with asyncio.TaskGroup() as clients:
            try:
                _detect_dead_peers(server)
                await server.start_serving()
                self.port = server.sockets[0].getsockname()[1]
                ready()
                self._component.say(State.OK, f"Modbus TCP on port {self.port}")
                await asyncio.get_running_loop().create_future()
            finally:
                server.close()

    def _admit(
        self, clients: asyncio.TaskGroup, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Start to serve a client; ``_clients`` has the one that has been quiet for longest in front."""
        if len(self._clients) >= MAX_CLIENTS:
            self._clients.pop(next(iter(self._clients))).cancel()
            self._component.count("clients_displaced")
        self._clients[writer] = clients.create_task(self._serve(reader, writer), name="modbus tcp client")
        self._clients[writer].add_done_callback(lambda _: self._dismiss(writer))
        self._component.count("clients")

    def _dismiss(self, writer: asyncio.StreamWriter) -> None:
        self._clients.pop(writer, None)
        self._component.count("clients", -1)
        writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one client until it leaves or stops making sense."""
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):  # it left
            while True:
                transaction, protocol, length, unit = MBAP.unpack(await reader.readexactly(MBAP.size))
                if protocol != 0 or not 2 <= length <= LONGEST:
                    self._component.count("garbled")  # where the next frame begins cannot be known
                    return
                answer = await self._answer(unit, await reader.readexactly(length - 1))
                writer.write(MBAP.pack(transaction, 0, len(answer) + 1, unit) + answer)
                await writer.drain()
                self._clients[writer] = self._clients.pop(writer)
                await asyncio.sleep(0)  # a client with many requests at once does not hold up the rest

    async def _answer(self, unit: int, request: bytes) -> bytes:
        if unit == self._settings.unit_id or unit in _DIRECT:
            return await self._responder.answer(request)
        self._component.count("other_units")
        return bytes([request[0] | 0x80, ExcCodes.GATEWAY_NO_RESPONSE])


def _detect_dead_peers(server: asyncio.Server) -> None:
    """Have the kernel end a connection whose other end has been gone for a minute (Messaging 4.3.2)."""
    for listener in server.sockets:  # what it accepts inherits its options
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 30)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 10)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
