"""Modbus TCP: requests in MBAP frames, from a few controllers at once, with or without TLS.

With a certificate the interface is Modbus/TCP Security: a client gets a place once its TLS handshake is over.
Handshakes in progress have their own places, with the same rule for displacing connections (``places``).

"Messaging" is the Modbus Messaging on TCP/IP Implementation Guide V1.0b, "Security" the MODBUS/TCP Security
Protocol Specification v36.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import socket
import ssl
import struct
from collections.abc import Callable, Mapping
from typing import Any

from altd.config import ModbusTcpSettings
from altd.credentials.certificates import RenewedContext, role_of, server_context
from altd.publish.modbus.places import Addresses, Connection, connection_to_displace
from altd.publish.modbus.responder import ExceptionCode, Responder
from altd.status.health import Component, State
from altd.status.unit import PublishedUnit
from altd.tcp_port import (
    CONNECTIONS,
    HANDSHAKE_TIMEOUT_S,
    MAX_HANDSHAKES,
    SHUTDOWN_TIMEOUT_S,
    Buckets,
    Networks,
    accept,
    address_of,
    group_of,
    is_among_last,
    listen_with_reserved,
)

log = logging.getLogger("altd")

MBAP = struct.Struct(">HHHB")
"""Header: transaction, protocol (0), number of bytes after the length, unit (Messaging 3.1.3)."""

MAX_LENGTH = 254
"""Maximum of the length field: the unit and a protocol data unit of 253 bytes."""

MAX_CLIENTS = 32
"""Maximum number of clients; with more, one is closed (Messaging 4.2), which ``places`` selects."""

RESERVED_DESCRIPTORS = 4
"""File descriptors reserved for cameras and ports."""

_DIRECT = frozenset({0, 255})
"""Unit ids of the device itself, not of a device behind a gateway (Messaging 4.4.1.2)."""

READ_AHEAD_BYTES = 1024
"""Limit of bytes that wait for a response: reading from a client pauses above twice as many."""


_Tasks = dict[Connection, asyncio.Task[None]]


class ModbusTcpPublisher:
    """Serves the unit over Modbus TCP, with or without TLS.

    Raises BadInputError for a certificate that cannot be used.
    """

    def __init__(self, settings: ModbusTcpSettings, unit: PublishedUnit, component: Component) -> None:
        self._settings = settings
        self._responder = Responder(settings, unit, component)
        self._component = component
        self._clients: _Tasks = {}
        self._handshakes: _Tasks = {}
        self._handshakes_begun = Buckets(CONNECTIONS, component.clock)
        self._context: RenewedContext | None = None
        if settings.certificate and settings.key and settings.client_ca:
            files = settings.certificate, settings.key, settings.client_ca
            self._context = RenewedContext(functools.partial(server_context, *files), files, self._set_state)
        self._addresses = Addresses()
        self._reserved = Networks(settings.reserved)
        self._response_turn = asyncio.Lock()
        """Limits all clients to one response per turn of the loop: many clients never block the unit."""
        self.port = settings.port_or_default
        """Port in use; for a setting of 0, the port that the system chose, once it listens."""

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError if the address is not available."""
        settings = self._settings
        with contextlib.ExitStack() as listening:
            listeners = listen_with_reserved(settings.host, settings.port_or_default, settings.reserved)
            for listener in map(listening.enter_context, listeners):
                _detect_dead_peers(listener)
                self.port = listener.getsockname()[1]
            async with asyncio.TaskGroup() as tasks:
                ready()
                self._set_state("")
                admit = functools.partial(self._admit, tasks)
                for listener in listeners:
                    tasks.create_task(accept(listener, self._component, admit), name="modbus tcp accept")

    def _set_state(self, complaint: str) -> None:
        """Set the state; ``complaint`` is the reason why a renewed certificate cannot be used, or empty."""
        if complaint:
            log.warning("%s: %s", self._component.name, complaint)
        tls = " with TLS" if self._context is not None else ""
        state = State.DEGRADED if complaint else State.OK
        self._component.set_state(state, complaint or f"Modbus TCP on port {self.port}{tls}")

    async def _admit(self, tasks: asyncio.TaskGroup, connection: socket.socket) -> None:
        """Serve a connection, begin its handshake, or close it."""
        client = self._client(connection.getpeername()[0], asyncio.get_running_loop().time())
        if self._context is None:
            await self._connect(tasks, client, connection, {})
        elif not client.is_reserved and self._handshakes_begun.take(client.address):
            self._component.count("connections_limited")
            connection.close()
        elif self._has_room(self._handshakes, MAX_HANDSHAKES, client, connection):
            shaking = self._shake_hands(tasks, client, connection, self._context())
            self._handshakes[client] = tasks.create_task(shaking, name="modbus tls handshake")
            await asyncio.sleep(0)  # start it: a task cancelled before its start would leave the socket open
        else:
            connection.close()

    def _has_room(self, present: _Tasks, limit: int, client: Connection, connection: socket.socket) -> bool:
        """Whether a client gets a place; if all are taken, another client may be displaced."""
        if len(present) < limit and not is_among_last(connection, RESERVED_DESCRIPTORS):
            return True
        displaced = connection_to_displace(list(present), client, asyncio.get_running_loop().time())
        if displaced is None:
            self._component.count("connections_refused")
            return False
        self._component.count("clients_displaced")
        present.pop(displaced).cancel()
        return True

    async def _shake_hands(
        self, tasks: asyncio.TaskGroup, client: Connection, connection: socket.socket, context: ssl.SSLContext
    ) -> None:
        tls = {
            "ssl": context,
            "ssl_handshake_timeout": HANDSHAKE_TIMEOUT_S,
            "ssl_shutdown_timeout": SHUTDOWN_TIMEOUT_S,
        }
        try:
            await self._connect(tasks, client, connection, tls)
        except OSError:  # no TLS, no accepted certificate, or the client left; includes ssl's errors
            self._component.count("handshakes_failed")
        finally:
            self._handshakes.pop(client, None)

    async def _connect(
        self, tasks: asyncio.TaskGroup, client: Connection, connection: socket.socket, tls: Mapping[str, Any]
    ) -> None:
        """Serve a connection once it is established, with ``tls`` after the handshake; raises OSError."""

        def begin(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            self._handshakes.pop(client, None)  # from here on nothing displaces it as a handshake
            if not self._has_room(self._clients, MAX_CLIENTS, client, connection):
                writer.transport.abort()
                return
            client.may_command = not tls or self._has_role(writer)
            requests = self._serve(client, reader, writer)
            try:
                serving = tasks.create_task(requests, name="modbus tcp client")
            except RuntimeError:  # the publisher is ending
                requests.close()
                writer.transport.abort()
                return
            serving.add_done_callback(lambda _: self._dismiss(client, writer))
            self._clients[client] = serving
            self._component.count("clients")

        streams = asyncio.StreamReaderProtocol(asyncio.StreamReader(READ_AHEAD_BYTES), begin)
        loop = asyncio.get_running_loop()
        await loop.connect_accepted_socket(lambda: streams, connection, **tls)

    def _has_role(self, writer: asyncio.StreamWriter) -> bool:
        """Whether a client's certificate has a role that may command (Security 8.4)."""
        certificate = writer.get_extra_info("ssl_object").getpeercert(binary_form=True)
        return certificate is not None and role_of(certificate) in self._settings.roles

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
        """Answer one client until it disconnects or sends an invalid header."""
        clock = asyncio.get_running_loop().time
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):  # the client left
            while True:
                transaction, protocol, length, unit = MBAP.unpack(await reader.readexactly(MBAP.size))
                if protocol != 0 or not 2 <= length <= MAX_LENGTH:
                    self._component.count("garbled")  # the start of the next frame is unknown
                    return
                request = await reader.readexactly(length - 1)
                async with self._response_turn:
                    answer = self._answer(unit, request, client.may_command)
                    client.ask(clock())
                    writer.write(MBAP.pack(transaction, 0, len(answer) + 1, unit) + answer)
                    await asyncio.sleep(0)
                await writer.drain()

    def _answer(self, unit: int, request: bytes, may_command: bool) -> bytes:
        if unit == self._settings.unit_id or unit in _DIRECT:
            return self._responder.answer(request, may_command)
        self._component.count("other_units")
        return bytes([request[0] | 0x80, ExceptionCode.GATEWAY_NO_RESPONSE])


def _detect_dead_peers(listener: socket.socket) -> None:
    """Make the kernel close connections whose peer has been gone for a minute (Messaging 4.3.2)."""
    # every accepted connection inherits these options
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 30)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 10)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
