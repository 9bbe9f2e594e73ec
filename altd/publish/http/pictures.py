"""Pictures of the targets over a WebSocket (RFC 6455): one message for each time that the browser asks.

The unit's first message is JSON text, ``{"views": […]}``: what does not change in the pictures. Whenever the
browser has drawn what it got it sends a text, and gets the newest pictures that it has not seen, as one
binary message: the length of a JSON header in four bytes, the highest first, that header, and the JPEGs
behind one another. So nothing waits on the way, however slow the browser is. ``held_s`` in the header is the
time from the text to the message: what more passed where the text was sent, passed on the way.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Sequence
from dataclasses import asdict

from starlette.websockets import WebSocket, WebSocketDisconnect

from altd.publish.http.guard import Guard, Refused
from altd.status.health import Component
from altd.status.picture_desk import NoPictureError, Picture, PictureDesk

PATH = "/api/v1/pictures"
"""OpenAPI knows no WebSocket, so that this one stands in no table of paths."""

MAX_VIEWERS = 16
"""Browsers that are shown pictures at a time."""

MAX_SILENCE_S = 30.0
"""A browser that asks for nothing for so long is closed: it asks again when somebody looks."""

NOTHING_NEW_S = 1.0
"""After so long the answer is a message without pictures, which says that the unit is there."""

MAX_REASON_LETTERS = 60
"""Of the 123 bytes that a close frame has room for."""

_SEND_TIMEOUT_S = 10.0
_TRY_LATER, _GOING_AWAY, _NOT_ACCEPTED, _NOT_ALLOWED = 1013, 1001, 1003, 1008
"""Status codes of closing (RFC 6455, 7.4, and its registry)."""


class Viewers:
    """Browsers that look at the targets, so that they stay few."""

    def __init__(self, desk: PictureDesk, component: Component, guard: Guard) -> None:
        self._desk = desk
        self._guard = guard
        self._component = component
        self.open = 0

    async def show(self, socket: WebSocket) -> None:
        """Serve one browser for as long as it asks."""
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
        maker = self._desk.maker
        views = json.dumps({"views": [view.as_object() for view in maker.views]}, allow_nan=False)
        await _within(socket.send_text(views))
        seen: dict[str, int] = {}
        while True:
            try:
                async with asyncio.timeout(MAX_SILENCE_S):
                    await socket.receive_text()
            except TimeoutError:
                await socket.close(_GOING_AWAY, "nothing was asked for")
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
    """Pictures as one message of the WebSocket, which is sent now and was asked for then."""
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
                    "spot": None if picture.spot is None else _rounded(asdict(picture.spot)),
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


def _rounded(spot: dict[str, float]) -> dict[str, float]:
    return {key: round(value, 2) for key, value in spot.items()}


def _is_own_page(socket: WebSocket) -> bool:
    """A browser says which page asks, and any page may open a WebSocket; what is no browser says nothing."""
    origin = socket.headers.get("Origin")
    scheme = "https" if socket.url.scheme == "wss" else "http"
    return origin is None or origin == f"{scheme}://{socket.headers.get('Host', '')}"


async def _within(sending: Awaitable[None]) -> None:
    """A browser that takes nothing is given up."""
    async with asyncio.timeout(_SEND_TIMEOUT_S):
        await sending


async def _refuse(socket: WebSocket, code: int, reason: str) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        await socket.accept()
        await socket.close(code, reason)
