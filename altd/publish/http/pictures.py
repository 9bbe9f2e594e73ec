"""Pictures of the targets over a WebSocket (RFC 6455): one message for each request of the browser.

Received bytes are limited, as parsing blocks the event loop, and with it the measurement: 256 kB, which
asyncio reads at once, can hold 43,000 empty pings.

The unit's first message is JSON text, ``{"views": […]}``: the constant part of the pictures. After drawing,
the browser sends a text and receives the newest pictures that it has not seen, as one binary message. That
is the length of a JSON header in four bytes, the highest first, the header, and the JPEGs one after another.
So nothing queues up in transit, however slow the browser is. ``held_s`` in the header is the time from the
text to the message; the rest of the time that the browser measures was spent in transit.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Sequence
from dataclasses import asdict
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.wsproto_impl import WSProtocol
from wsproto.events import Ping

from altd.publish.http.errors import Refused
from altd.publish.http.guard import Guard
from altd.status.health import Component
from altd.status.services import NoPictureError, Picture, PictureService

MAX_BYTES_AT_ONCE = 2048
MAX_BYTES_PER_S = 1024
"""Maximum rate of received bytes; for ten pictures a second a browser sends 100."""


class BoundedWebSocket(WSProtocol):
    """WebSocket with a limit on received bytes; a failure ends only its own connection."""

    _allowed_bytes: float = MAX_BYTES_AT_ONCE
    _counted_s: float | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take over from HTTP without its default headers, which announce that the connection closes."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101  a socket's always is
        super().connection_made(transport)
        self.default_headers = []

    def data_received(self, data: bytes) -> None:
        """Disconnect clients that violate the protocol or send more than a browser does."""
        if self._counted_s is None:  # the handshake, which HTTP has limited
            self._counted_s = self.loop.time()
        elif not self._takes(len(data)):
            self.transport.abort()
            return
        try:
            super().data_received(data)
        except Exception:
            self.transport.abort()

    async def send(self, message: Any) -> None:
        """Send nothing once an oversized message has closed it: uvicorn treats that as a defect."""
        if self.close_sent:
            raise ClientDisconnected
        await super().send(message)

    def handle_ping(self, event: Ping) -> None:
        """Answer only while the client is connected: asyncio logs each write after it has left."""
        if not self.transport.is_closing():
            super().handle_ping(event)

    def _takes(self, count: int) -> bool:
        now_s = self.loop.time()
        gained = (now_s - (self._counted_s or now_s)) * MAX_BYTES_PER_S
        self._counted_s = now_s
        self._allowed_bytes = min(self._allowed_bytes + gained, MAX_BYTES_AT_ONCE) - count
        return self._allowed_bytes >= 0


PATH = "/api/v1/pictures"
"""Path of the WebSocket; not in the table of paths because OpenAPI does not cover WebSockets."""

MAX_VIEWERS = 16
"""Maximum number of browsers that receive pictures at a time."""

MAX_SILENCE_S = 30.0
"""Time without a request until a browser is disconnected; it connects again when it is visible."""

NOTHING_NEW_S = 1.0
"""Time without new pictures until a message without pictures is sent, which shows that the unit is alive."""

MAX_REASON_LETTERS = 60
"""Maximum length of a reason for closing; a close frame has room for 123 bytes."""

_SEND_TIMEOUT_S = 10.0
_TRY_LATER, _GOING_AWAY, _NOT_ACCEPTED, _NOT_ALLOWED = 1013, 1001, 1003, 1008
"""Status codes for closing (RFC 6455, 7.4, and its registry)."""


class Viewers:
    """Sends pictures of the targets to a limited number of browsers."""

    def __init__(self, service: PictureService, component: Component, guard: Guard) -> None:
        self._service = service
        self._guard = guard
        self._component = component
        self.open = 0

    async def show(self, socket: WebSocket) -> None:
        """Serve one browser as long as it sends requests."""
        if not _is_own_page(socket):
            await socket.close()  # 403
            return
        try:
            self._guard.check_may_look(socket)
        except Refused as refused:
            await socket.send_denial_response(refused.answer)
            return
        if self.open >= MAX_VIEWERS:
            self._component.count("viewers_refused")
            await _refuse(socket, _TRY_LATER, f"{MAX_VIEWERS} browsers look already")
            return
        self.open += 1
        try:
            await self._serve(socket)
        except (WebSocketDisconnect, TimeoutError):
            return
        except NoPictureError as error:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                await socket.close(_TRY_LATER, str(error)[:MAX_REASON_LETTERS])
        finally:
            self.open -= 1

    async def _serve(self, socket: WebSocket) -> None:
        await socket.accept()
        maker = self._service.provider
        views = json.dumps({"views": [view.as_object() for view in maker.views]}, allow_nan=False)
        await _within(socket.send_text(views))
        seen: dict[str, int] = {}
        while True:
            try:
                async with asyncio.timeout(MAX_SILENCE_S):
                    await socket.receive_text()
            except TimeoutError:
                await socket.close(_GOING_AWAY, "no picture was requested")
                return
            except KeyError:  # a binary message
                await socket.close(_NOT_ACCEPTED, "ask by a text")
                return
            try:
                self._guard.check_may_look(socket)
            except Refused:
                await socket.close(_NOT_ALLOWED, "log in again")
                return
            asked_ns = self._component.clock.monotonic_ns()
            pictures: Sequence[Picture] = ()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(NOTHING_NEW_S):
                    pictures = await maker.newer(seen)
            seen |= {picture.target: picture.number for picture in pictures}
            self._component.count("pictures", len(pictures))
            await _within(
                socket.send_bytes(message(pictures, asked_ns, self._component.clock.monotonic_ns()))
            )


def message(pictures: Sequence[Picture], asked_ns: int, now_ns: int) -> bytes:
    """Return pictures as one WebSocket message, requested at ``asked_ns`` and sent at ``now_ns``."""
    header = json.dumps(
        {
            "held_s": round((now_ns - asked_ns) * 1e-9, 3),
            "pictures": [
                {
                    "target": picture.target,
                    "sequence": picture.sequence,
                    "age_s": round((now_ns - picture.t_ns) * 1e-9, 3),
                    "width": picture.width,
                    "height": picture.height,
                    "spot": picture.spot
                    and {key: round(value, 2) for key, value in asdict(picture.spot).items()},
                    "why": picture.why,
                    "leds_on": picture.leds_on,
                    "bytes": len(picture.jpeg),
                }
                for picture in pictures
            ],
        },
        allow_nan=False,
    ).encode()
    return b"".join([len(header).to_bytes(4, "big"), header, *(picture.jpeg for picture in pictures)])


def _is_own_page(socket: WebSocket) -> bool:
    """Whether no foreign page opens the socket, as any page may: only browsers send the page's origin."""
    origin = socket.headers.get("Origin")
    scheme = "https" if socket.url.scheme == "wss" else "http"
    return origin is None or origin == f"{scheme}://{socket.headers.get('Host', '')}"


async def _within(sending: Awaitable[None]) -> None:
    """Send within the time limit; raises TimeoutError if the browser receives nothing."""
    async with asyncio.timeout(_SEND_TIMEOUT_S):
        await sending


async def _refuse(socket: WebSocket, code: int, reason: str) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        await socket.accept()
        await socket.close(code, reason)
