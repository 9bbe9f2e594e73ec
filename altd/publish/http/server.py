"""uvicorn inside the daemon's loop, with bounds against clients that are slow, many or hostile.

What uvicorn leaves open and this module closes: it installs signal handlers, it exits the process when the
port is taken, it never stops waiting for the end of a request header, its ``limit_concurrency`` refuses
requests but keeps the connections, it fails where a request turns out malformed after its header, and it does
not end by cancellation.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import socket
import ssl
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import cast

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle
from uvicorn.protocols.utils import is_ssl

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
"""More than these are closed at once: a flood must leave the daemon its file descriptors."""

RESERVED_DESCRIPTORS = 8
"""Descriptors left to controllers, cameras and ports where the process may have few."""

REQUEST_TIMEOUT_S = 10.0
"""A client that has not sent a whole request header by then is cut off."""

SEND_TIMEOUT_S = 20
"""A client that takes nothing for so long is cut off by the kernel."""

MAX_HEADER_BYTES = 8192
MAX_HEADER_LINES = 64

_BLANK_LINE = re.compile(rb"\n\r?\n")
"""The bytes that h11 accepts as the end of a header."""

_CHUNKED = re.compile(rb"\ntransfer-encoding:", re.IGNORECASE)
"""A body in chunks is refused: to parse 4 kB of the smallest would hold the event loop for 5 to 18 ms."""

MAX_BYTES_BEHIND_HEADER = 4608
"""More than the largest body, a login of 4096, so that a larger one is recognised; the rest is dropped."""

MAX_MESSAGE_BYTES = 256
"""Of a browser over a WebSocket: it only asks for the next picture."""

PING_INTERVAL_S = 10.0
"""A WebSocket is asked whether it is there; without an answer for so long it is closed."""

_SEND_BUFFER_BYTES = 16384
"""Small, so that a slow reader of the stream skips measurements instead of getting old ones."""

_HEADERS = [
    ("Cache-Control", "no-store"),
    ("Connection", "close"),  # one request a connection: what is not asking costs nothing
    ("X-Content-Type-Options", "nosniff"),
]


def listen(settings: HttpSettings) -> socket.socket:
    """The listening socket; raises OSError as ``altd.tcp_port.listen`` does."""
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
    """Limit of an address's connections where each costs a handshake."""

    def refuses(self, connection: socket.socket) -> str:
        """Why a connection is closed unanswered, as the name of a counter; empty: it is not."""
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
    """Serve until cancelled; every connection is closed by then."""
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
        headers=_HEADERS,
        timeout_graceful_shutdown=2,
        h11_max_incomplete_event_size=MAX_HEADER_BYTES,
    )
    await _Server(config, listener, component, policy, ready).serve()


class _Server(uvicorn.Server):
    """Leaves the signals to the daemon, accepts connections in altd's way and ends by cancellation."""

    def __init__(
        self,
        config: uvicorn.Config,
        listener: socket.socket,
        component: Component,
        policy: ConnectionPolicy,
        ready: Callable[[], None],
    ) -> None:
        super().__init__(config)
        self._listener = listener
        self._component = component
        self._policy = policy
        self._ready = ready
        self._handshakes: set[asyncio.Task[None]] = set()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Install no handlers."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Leave the listening to ``main_loop``."""
        self.servers = []
        self.started = True

    async def main_loop(self) -> None:
        """Serve; cut every connection on the way out, which ends the tasks behind them."""
        accepting = asyncio.ensure_future(accept(self._listener, self._component, self._admit))
        self._ready()
        try:
            await asyncio.gather(accepting, super().main_loop())
        finally:
            accepting.cancel()
            for handshake in self._handshakes:
                handshake.cancel()
            await asyncio.gather(*self._handshakes, return_exceptions=True)
            for connection in list(self.server_state.connections):
                connection.transport.abort()
            await self.shutdown()

    async def _admit(self, connection: socket.socket) -> None:
        """Serve a connection, or close it where it may not be or there are enough."""
        why = self._policy.refuses(connection) or self._is_full(connection)
        if why:
            self._component.count(why)
            connection.close()
            return
        # unlike TCP, a local socket inherits no options of the listener
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        if self._policy.certificate is None:
            protocol = _BoundedProtocol(self.config, self.server_state, {})
            await asyncio.get_running_loop().connect_accepted_socket(lambda: protocol, connection)
            return
        task = asyncio.create_task(self._shake_hands(connection, self._policy.certificate()))
        self._handshakes.add(task)
        task.add_done_callback(self._handshakes.discard)

    def _is_full(self, connection: socket.socket) -> str:
        taken = len(self.server_state.connections) + len(self._handshakes)
        is_full = taken >= MAX_CONNECTIONS or len(self._handshakes) >= MAX_HANDSHAKES
        return "connections_refused" if is_full or is_among_last(connection, RESERVED_DESCRIPTORS) else ""

    async def _shake_hands(self, connection: socket.socket, context: ssl.SSLContext) -> None:
        """TLS over a connection that is already ours, so that its buffer is as small as without TLS."""
        loop = asyncio.get_running_loop()
        protocol = _BoundedProtocol(self.config, self.server_state, {})
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
        except OSError:  # no TLS, none that we speak, or it left; ssl's errors are among these
            secured = None
        if secured is None or secured.is_closing():  # None of Python 3.11.2: it left at once
            self._component.count("handshakes_failed")
            connection.close()
            return
        protocol.connection_made(secured)


class _Silent(asyncio.Protocol):
    """Holds a connection until TLS takes it over: reads nothing, keeps nothing to be sent."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Stop before the first byte."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101  of a socket it is one
        transport.pause_reading()
        transport.set_write_buffer_limits(high=0)


class _BoundedProtocol(H11Protocol):
    """uvicorn's HTTP protocol with time limits."""

    _deadline: asyncio.TimerHandle | None = None
    _stuck: asyncio.TimerHandle | None = None
    _head: bytes | None = b""
    """The bytes of the first header so far; None: it is complete."""
    _behind_bytes = 0
    """The bytes behind the header that were passed on."""
    _early: bytes = b""
    """Bytes that TLS deciphered before the handshake ended, for ``connection_made``."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Write nothing ahead of the client, and wait for its request only so long."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101  of a socket it is one
        super().connection_made(transport)
        # asyncio's TLS would stop at a mark of 0 and never resume
        transport.set_write_buffer_limits(high=1 if is_ssl(transport) else 0)
        self._deadline = self.loop.call_later(REQUEST_TIMEOUT_S, self._give_up)
        if early := self._early:
            self._early = b""
            self.data_received(early)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the deadline."""
        for timer in (self._deadline, self._stuck):
            if timer is not None:
                timer.cancel()
        if cast("object | None", self.transport) is not None:  # uvicorn's annotation knows no None
            super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Pass it on while its header is within bounds: h11 bounds only one that comes in pieces."""
        if cast("object | None", self.transport) is None:
            self._early += data
            return
        behind = len(data)
        if self._head is not None:
            came = self._head + data
            end = _BLANK_LINE.search(came)
            head = came if end is None else came[: end.end()]
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
        if excess and self.transport.get_protocol() is self:  # a WebSocket continues, with bounds of its own
            self.transport.pause_reading()

    def pause_writing(self) -> None:
        """The client takes nothing now: where no TCP cuts it off, this does."""
        super().pause_writing()
        if self.transport.get_extra_info("socket").family == socket.AF_UNIX:
            self._stuck = self.loop.call_later(SEND_TIMEOUT_S, self.transport.abort)

    def resume_writing(self) -> None:
        """The transport has sent its buffer."""
        if self._stuck is not None:
            self._stuck.cancel()
        super().resume_writing()

    def send_400_response(self, msg: str) -> None:
        """Answer what is malformed, if no answer is under way; an answer under way ends.

        uvicorn would send a second answer, and log a traceback when h11 refuses that.
        """
        cycle = cast("RequestResponseCycle | None", self.cycle)  # uvicorn's annotation knows no None
        if cycle is not None:
            cycle.disconnected = True
            cycle.message_event.set()
        self._refuse(400, "not an HTTP request")

    def _refuse(self, status: int, sentence: str) -> None:
        """Say in one answer why there is none, and close; cut where an answer is under way already."""
        if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            self.transport.abort()
            return
        body = error_body(sentence)
        headers = [*_HEADERS, ("Content-Type", "application/json"), ("Content-Length", str(len(body)))]
        asked = cast("RequestResponseCycle | None", self.cycle)
        sent = b"" if asked is not None and asked.scope["method"] == "HEAD" else body
        events = (h11.Response(status_code=status, headers=headers), h11.Data(data=sent), h11.EndOfMessage())
        self.transport.write(b"".join(self.conn.send(event) or b"" for event in events))
        self.transport.close()

    def _should_upgrade_to_ws(self) -> bool:
        """Elsewhere the wish to upgrade is ignored."""
        return self.scope["path"] == pictures.PATH

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """A WebSocket has its own bounds."""
        if self._deadline is not None:
            self._deadline.cancel()
        super().handle_websocket_upgrade(event)

    def _give_up(self) -> None:
        asked = cast("object | None", self.cycle)  # uvicorn's annotation knows no None
        if asked is None:
            self.transport.abort()
