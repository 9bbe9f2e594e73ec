"""uvicorn's WebSocket protocol with a bound on how much a client may send.

What is parsed holds the event loop, and with it the measurement: 256 kB, which is what asyncio reads at once,
have room for 43,000 empty pings.
"""

from __future__ import annotations

import asyncio

from uvicorn._types import ASGISendEvent
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.wsproto_impl import WSProtocol
from wsproto.events import Ping

MAX_BYTES_AT_ONCE = 2048
MAX_BYTES_PER_S = 1024
"""For ten pictures a second a browser sends 100."""


class BoundedWebSocket(WSProtocol):
    """Whatever it fails on ends the connection and nothing else."""

    _allowed_bytes: float = MAX_BYTES_AT_ONCE
    _counted_s: float | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take over from HTTP, whose headers for each answer would say that the connection closes."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101  of a socket it is one
        super().connection_made(transport)
        self.default_headers = []

    def data_received(self, data: bytes) -> None:
        """What is no WebSocket is cut off, and so is who sends more than a browser does."""
        if self._counted_s is None:  # the handshake, which HTTP has bounded
            self._counted_s = self.loop.time()
        elif not self._takes(len(data)):
            self.transport.abort()
            return
        try:
            super().data_received(data)
        except Exception:
            self.transport.abort()

    async def send(self, message: ASGISendEvent) -> None:
        """Say nothing after a message that was too large has closed it: uvicorn takes that for a defect."""
        if self.close_sent:
            raise ClientDisconnected
        await super().send(message)

    def handle_ping(self, event: Ping) -> None:
        """Answer while there is somebody: asyncio logs each piece that is written to nobody."""
        if not self.transport.is_closing():
            super().handle_ping(event)

    def _takes(self, count: int) -> bool:
        now_s = self.loop.time()
        gained = (now_s - (self._counted_s or now_s)) * MAX_BYTES_PER_S
        self._counted_s = now_s
        self._allowed_bytes = min(self._allowed_bytes + gained, MAX_BYTES_AT_ONCE) - count
        return self._allowed_bytes >= 0
