"""uvicorn inside the daemon's loop, with bounds against clients that are slow, many or hostile.

What uvicorn leaves open and this module closes: it installs signal handlers, it exits the process when the
port is taken, it waits for ever for the end of a request header, its ``limit_concurrency`` refuses requests
but keeps the connections, it fails where a request turns out malformed after its header, and it does not end
by cancellation.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable, Iterator
from typing import cast

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from altd.config import HttpSettings
from altd.status.health import Component
from altd.tcp_port.accepting import accept, is_among_last
from altd.tcp_port.accepting import listen as listen_tcp

MAX_CONNECTIONS = 64
"""More than these are closed at once: a flood must leave the daemon its file descriptors."""

RESERVED_DESCRIPTORS = 8
"""Where the process may have few descriptors, so many are left to controllers, cameras and ports."""

REQUEST_TIMEOUT_S = 10.0
"""A client that has not sent a whole request header by then is cut off."""

SEND_TIMEOUT_S = 20
"""A client that takes nothing for so long is cut off by the kernel."""

MAX_HEADER_BYTES = 8192

_SEND_BUFFER_BYTES = 16384
"""Small, so that a slow reader of the stream skips measurements instead of getting old ones."""

_HEADERS = [
    ("Cache-Control", "no-store"),
    ("Connection", "close"),  # one request a connection: what is not asking costs nothing
    ("X-Content-Type-Options", "nosniff"),
]


def listen(settings: HttpSettings) -> socket.socket:
    """The listening socket; raises OSError that names the address."""
    listener = listen_tcp(settings.host, settings.port)
    # what is set here every accepted connection inherits
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 1000 * SEND_TIMEOUT_S)
    return listener


async def serve(
    application: ASGIApp, listener: socket.socket, component: Component, ready: Callable[[], None]
) -> None:
    """Serve until cancelled; every connection is closed by then."""
    config = uvicorn.Config(
        application,
        http=_BoundedProtocol,
        ws="none",
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
    await _Server(config, listener, component, ready).serve()


class _Server(uvicorn.Server):
    """Leaves the signals to the daemon, accepts connections in altd's way and ends by cancellation."""

    def __init__(
        self, config: uvicorn.Config, listener: socket.socket, component: Component, ready: Callable[[], None]
    ) -> None:
        super().__init__(config)
        self._listener = listener
        self._component = component
        self._ready = ready

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
            for connection in list(self.server_state.connections):
                connection.transport.abort()
            await self.shutdown()

    async def _admit(self, connection: socket.socket) -> None:
        """Serve a connection, or close it where there are enough."""
        if len(self.server_state.connections) >= MAX_CONNECTIONS or is_among_last(
            connection, RESERVED_DESCRIPTORS
        ):
            self._component.count("connections_refused")
            connection.close()
            return
        await asyncio.get_running_loop().connect_accepted_socket(
            lambda: _BoundedProtocol(self.config, self.server_state, {}), connection
        )


class _BoundedProtocol(H11Protocol):
    """uvicorn's HTTP protocol with an end to its patience."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn
        """Write nothing ahead of the client, and wait for its request only so long."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=0)
        self._deadline = self.loop.call_later(REQUEST_TIMEOUT_S, self._give_up)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the deadline."""
        if self._deadline is not None:
            self._deadline.cancel()
        super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        """Answer what is malformed, if no answer is under way; whatever is under way ends.

        uvicorn would send a second answer, and log a traceback when h11 refuses that.
        """
        cycle = cast("RequestResponseCycle | None", self.cycle)  # uvicorn's annotation knows no None
        if cycle is not None:
            cycle.disconnected = True
            cycle.message_event.set()
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            super().send_400_response(msg)
        else:
            self.transport.abort()

    def _give_up(self) -> None:
        asked = cast("object | None", self.cycle)  # uvicorn's annotation knows no None
        if asked is None:
            self.transport.abort()
