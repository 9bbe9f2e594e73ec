"""Large answers, of which a few are made and sent at a time, however many ask."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping

from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from altd.publish.http.errors import refusal

MAX_DOWNLOADS = 2
"""Recordings, diagnostics, calibration files and reports that are made or sent at a time."""

PIECE_BYTES = 1 << 18
"""So much of an answer waits for its client."""

_NOT_IN_A_NAME = re.compile(r"[^0-9A-Za-z._-]")


class Downloads:
    """Those of one interface that are under way."""

    def __init__(self) -> None:
        self.open = 0

    def of(self, make: Callable[[], Awaitable[Response]]) -> Response:
        """The answer that ``make`` gives once its turn has come; 503 where enough are under way."""
        return _Download(self, make)


class _Download(Response):
    """Counted from before it is made until it is sent, or the client has gone."""

    def __init__(self, downloads: Downloads, make: Callable[[], Awaitable[Response]]) -> None:
        super().__init__()
        self._downloads = downloads
        self._make = make

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Make and send it."""
        if self._downloads.open >= MAX_DOWNLOADS:
            await refusal(503, f"{MAX_DOWNLOADS} downloads are under way already")(scope, receive, send)
            return
        self._downloads.open += 1
        try:
            await (await self._make())(scope, receive, send)
        finally:
            self._downloads.open -= 1


def sent_whole(content: bytes, media_type: str, headers: Mapping[str, str]) -> Response:
    """An answer that is under way until its client has taken it, but for the last piece."""

    async def pieces() -> AsyncIterator[bytes]:
        for begin in range(0, len(content), PIECE_BYTES):
            yield content[begin : begin + PIECE_BYTES]

    sized = {**headers, "Content-Length": str(len(content))}
    return StreamingResponse(pieces(), media_type=media_type, headers=sized)


def saved_as(name: str) -> dict[str, str]:
    """The header that has a browser save the answer under this name, in letters that any system takes."""
    return {"Content-Disposition": f'attachment; filename="{_NOT_IN_A_NAME.sub("_", name)}"'}
