"""uvicorn's protocol on connections that altd accepts, with limits against slow, numerous or hostile clients.

uvicorn's server is not used: it installs signal handlers, exits the process when the port is taken, and does
not end by cancellation. Its ``limit_concurrency`` refuses requests but keeps the connections. Its protocol
waits for the end of a request header without limit, and fails on a request that turns out malformed after its
header.
"""

from __future__ import annotations

import asyncio
import re
import socket
import ssl
from collections.abc import Callable
from dataclasses import dataclass
from email.utils import formatdate
from typing import cast

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle
from uvicorn.protocols.utils import is_ssl
from uvicorn.server import ServerState

from altd.config import HttpSettings
from altd.publish.http import pictures
from altd.publish.http.clients import Allowed
from altd.publish.http.errors import error_body
from altd.publish.http.pictures import BoundedWebSocket
from altd.status.health import Component
from altd.tcp_port import (
    HANDSHAKE_TIMEOUT_S,
    MAX_HANDSHAKES,
    SHUTDOWN_TIMEOUT_S,
    Buckets,
    accept,
    address_of,
    group_of,
    is_among_last,
    is_loopback,
)
from altd.tcp_port import listen as listen_tcp

MAX_CONNECTIONS = 64
"""Maximum number of connections; more are closed at once: a flood must leave the daemon descriptors."""

RESERVED_DESCRIPTORS = 8
"""Descriptors reserved for controllers, cameras and ports if the limit of the process is low."""

REQUEST_TIMEOUT_S = 10.0
"""Time limit for a whole request header; then the client is disconnected."""

SEND_TIMEOUT_S = 20
"""Maximum time for which a client may receive nothing; then the kernel disconnects it."""

MAX_HEADER_BYTES = 8192
MAX_HEADER_LINES = 64

_BLANK_LINE = re.compile(rb"\n\r?\n")
"""Bytes that h11 accepts as the end of a header."""

_CHUNKED = re.compile(rb"\ntransfer-encoding:", re.IGNORECASE)
"""Header of a chunked body, refused because 4 kB of the smallest chunks block the loop for 5 to 18 ms."""

MAX_BYTES_BEHIND_HEADER = 4608
"""Maximum bytes read after a header: more than a login's 4096, to detect larger ones; the rest is dropped."""

MAX_MESSAGE_BYTES = 256
"""Maximum size of a WebSocket message from a browser, which only requests the next picture."""

PING_INTERVAL_S = 10.0
"""Interval of pings on a WebSocket, and time without a response until it is closed."""

_END_TIMEOUT_S = 2.0
"""Time for requests to end when their connections were aborted."""

_SEND_BUFFER_BYTES = 16384
"""Size of the send buffer; small, so that slow clients of the stream skip measurements, not lag behind."""


def listen(settings: HttpSettings) -> socket.socket:
    """Return the listening socket; raises OSError as ``altd.tcp_port.listen`` does."""
    listener = listen_tcp(settings.host, settings.port)
    # every accepted connection inherits these options
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 1000 * SEND_TIMEOUT_S)
    return listener


@dataclass(frozen=True, slots=True)
class ConnectionPolicy:
    """Limits on a connection before a byte is read, and its TLS."""

    allowed: Allowed
    certificate: Callable[[], ssl.SSLContext] | None
    connections: Buckets
    """Limit of new connections per address if each costs a handshake."""

    def refuses(self, connection: socket.socket) -> str:
        """Return the counter of the reason to close a connection unanswered; empty: it is accepted."""
        if connection.family == socket.AF_UNIX:
            return ""
        host = connection.getpeername()[0]
        if host not in self.allowed:
            return "connections_not_allowed"
        address = address_of(host)
        if self.certificate is None or address is None or is_loopback(address):
            return ""
        return "connections_limited" if self.connections.take(group_of(address)) else ""


async def serve(
    application: ASGIApp,
    listener: socket.socket,
    component: Component,
    policy: ConnectionPolicy,
    ready: Callable[[], None],
) -> None:
    """Serve until cancelled; then every connection is closed."""
    config = uvicorn.Config(
        application,
        http=_BoundedProtocol,
        ws=BoundedWebSocket,
        ws_max_size=MAX_MESSAGE_BYTES,
        ws_ping_interval=PING_INTERVAL_S,
        ws_ping_timeout=PING_INTERVAL_S,
        ws_per_message_deflate=False,
        lifespan="off",
        log_config=None,
        log_level="error",
        access_log=False,
        proxy_headers=False,
        server_header=False,
        # one request per connection: idle clients cost nothing
        headers=[
            ("Cache-Control", "no-store"),
            ("Connection", "close"),
            ("X-Content-Type-Options", "nosniff"),
        ],
        h11_max_incomplete_event_size=MAX_HEADER_BYTES,
    )
    config.load()
    server = _Server(config, component, policy)
    ready()
    try:
        await accept(listener, component, server.admit)
    finally:
        await server.close()


class _Server:
    """Serves connections within altd's limits."""

    def __init__(self, config: uvicorn.Config, component: Component, policy: ConnectionPolicy) -> None:
        self._config = config
        self._component = component
        self._policy = policy
        self._state = ServerState()
        self._handshakes: set[asyncio.Task[None]] = set()

    async def close(self) -> None:
        """Abort every connection, and end its tasks."""
        for handshake in self._handshakes:
            handshake.cancel()
        await asyncio.gather(*self._handshakes, return_exceptions=True)
        for connection in list(self._state.connections):
            connection.transport.abort()
        if self._state.tasks:
            _, late = await asyncio.wait(self._state.tasks, timeout=_END_TIMEOUT_S)
            for task in late:
                task.cancel()

    async def admit(self, connection: socket.socket) -> None:
        """Serve a connection, or close it if it is not allowed or there are too many."""
        why = self._policy.refuses(connection) or self._is_full(connection)
        if why:
            self._component.count(why)
            connection.close()
            return
        # unlike TCP, a local socket inherits no options of the listener
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        if self._policy.certificate is None:
            protocol = _BoundedProtocol(self._config, self._state, {})
            await asyncio.get_running_loop().connect_accepted_socket(lambda: protocol, connection)
            return
        task = asyncio.create_task(self._shake_hands(connection, self._policy.certificate()))
        self._handshakes.add(task)
        task.add_done_callback(self._handshakes.discard)

    def _is_full(self, connection: socket.socket) -> str:
        taken = len(self._state.connections) + len(self._handshakes)
        is_full = taken >= MAX_CONNECTIONS or len(self._handshakes) >= MAX_HANDSHAKES
        return "connections_refused" if is_full or is_among_last(connection, RESERVED_DESCRIPTORS) else ""

    async def _shake_hands(self, connection: socket.socket, context: ssl.SSLContext) -> None:
        """Start TLS on a connection that is already ours, so that its buffer is as small as without TLS."""
        loop = asyncio.get_running_loop()
        protocol = _BoundedProtocol(self._config, self._state, {})
        try:
            transport, _ = await loop.connect_accepted_socket(_Silent, connection)
            secured = await loop.start_tls(
                transport,
                protocol,
                context,
                server_side=True,
                ssl_handshake_timeout=HANDSHAKE_TIMEOUT_S,
                ssl_shutdown_timeout=SHUTDOWN_TIMEOUT_S,
            )
        except OSError:  # no TLS, an unsupported one, or the client left; includes ssl's errors
            secured = None
        if secured is None or secured.is_closing():  # None from Python 3.11.2: the client left at once
            self._component.count("handshakes_failed")
            connection.close()
            return
        protocol.connection_made(secured)


class _Silent(asyncio.Protocol):
    """Holds a connection until TLS takes it over; reads nothing and buffers nothing for sending."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Stop reading before the first byte."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101  a socket's always is
        transport.pause_reading()
        transport.set_write_buffer_limits(high=0)


class _BoundedProtocol(H11Protocol):
    """uvicorn's HTTP protocol with limits on time and size."""

    _deadline: asyncio.TimerHandle | None = None
    _stuck: asyncio.TimerHandle | None = None
    _head: bytes | None = b""
    """Bytes of the first header so far; None: it is complete."""
    _behind_bytes = 0
    """Number of bytes after the header that were forwarded."""
    _is_head_request = False
    _early: bytes = b""
    """Bytes that TLS decrypted before the handshake ended, for ``connection_made``."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Buffer no output ahead of the client, and limit the wait for its request."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101  a socket's always is
        super().connection_made(transport)
        # asyncio's TLS would stop at a limit of 0 and never resume
        transport.set_write_buffer_limits(high=1 if is_ssl(transport) else 0)
        self._deadline = self.loop.call_later(REQUEST_TIMEOUT_S, self._give_up)
        if early := self._early:
            self._early = b""
            self.data_received(early)

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel the timers."""
        for timer in (self._deadline, self._stuck):
            if timer is not None:
                timer.cancel()
        if cast("object | None", self.transport) is not None:  # uvicorn's annotation lacks None
            super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Forward data while the header is within its limits: h11 limits only a header received in pieces."""
        if cast("object | None", self.transport) is None:
            self._early += data
            return
        date = formatdate(usegmt=True).encode()
        self.server_state.default_headers = [(b"date", date), *self.config.encoded_headers]
        if self._head == b"":
            data = data.removeprefix(b"\r\n")  # RFC 9112, 2.2: an empty line before a request is ignored
        behind = len(data)
        if self._head is not None:
            came = self._head + data
            self._is_head_request = came.startswith(b"HEAD ")
            end = _BLANK_LINE.search(came)
            head = came if end is None else came[: end.end()]
            if len(head) > MAX_HEADER_BYTES and b"\n" not in head[:MAX_HEADER_BYTES]:
                self._refuse(414, "its path is too long")
                return
            if len(head) > MAX_HEADER_BYTES or head.count(b"\n") > MAX_HEADER_LINES:
                self._refuse(431, "its header is too large, or has too many lines")
                return
            if end is not None and _CHUNKED.search(head):
                self._refuse(411, "its body has no Content-Length")
                return
            self._head = came if end is None else None
            behind = 0 if end is None else len(came) - end.end()
        excess = min(max(self._behind_bytes + behind - MAX_BYTES_BEHIND_HEADER, 0), behind)
        self._behind_bytes += behind - excess
        if passed := data[: len(data) - excess]:
            super().data_received(passed)
        if excess and self.transport.get_protocol() is self:  # a WebSocket continues, with its own limits
            self.transport.pause_reading()

    def pause_writing(self) -> None:
        """Limit the time of a client that receives nothing on a local socket, where no TCP disconnects it."""
        super().pause_writing()
        if self.transport.get_extra_info("socket").family == socket.AF_UNIX:
            self._stuck = self.loop.call_later(SEND_TIMEOUT_S, self.transport.abort)

    def resume_writing(self) -> None:
        """Cancel the timer: the transport has sent its buffer."""
        if self._stuck is not None:
            self._stuck.cancel()
        super().resume_writing()

    def send_400_response(self, msg: str) -> None:
        """Answer a malformed request; a response that is already being sent is aborted instead.

        uvicorn would send a second response, and log a traceback when h11 refuses it.
        """
        cycle = cast("RequestResponseCycle | None", self.cycle)  # uvicorn's annotation lacks None
        if cycle is not None:
            cycle.disconnected = True
            cycle.message_event.set()
        self._refuse(400, "not an HTTP request")

    def _refuse(self, status: int, sentence: str) -> None:
        """Send an error response and close; abort if another response is already being sent."""
        if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            self.transport.abort()
            return
        body = error_body(sentence)
        about = [(b"Content-Type", b"application/json"), (b"Content-Length", b"%d" % len(body))]
        headers = [*self.server_state.default_headers, *about]
        head = self.conn.send(h11.Response(status_code=status, headers=headers)) or b""
        self.transport.write(head + (b"" if self._is_head_request else body))
        self.transport.close()

    def _should_upgrade_to_ws(self) -> bool:
        """Whether the path is that of the WebSocket; on others a request to upgrade is ignored."""
        return self.scope["path"] == pictures.PATH

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Cancel the time limit of the request: a WebSocket has its own limits."""
        if self._deadline is not None:
            self._deadline.cancel()
        super().handle_websocket_upgrade(event)

    def _give_up(self) -> None:
        if cast("object | None", self.cycle) is None:  # uvicorn's annotation lacks None
            self.transport.abort()
