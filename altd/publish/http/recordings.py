"""Recordings that the unit has kept, and how large answers are made and sent, a few at a time."""

from __future__ import annotations

import re
import tarfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence

from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from altd.publish.http.errors import Refused, refusal
from altd.publish.http.guard import Guard
from altd.status.services import NotKeptError, RecordingKeeper, RecordingService

MAX_DOWNLOADS = 2
"""Recordings, diagnostics, calibration files and reports that are made or sent at a time."""

PIECE_BYTES = 1 << 18
"""So much of an answer waits for its client."""

_NOT_IN_A_NAME = re.compile(r"[^0-9A-Za-z._-]")


class Downloads:
    """The active downloads of one interface."""

    def __init__(self) -> None:
        self.open = 0


class Download(Response):
    """The answer that ``make`` gives; 503 where enough are under way.

    It counts from before it is made until it is sent, or the client has gone.
    """

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


_TAR = "application/x-tar"
_BLOCK = tarfile.BLOCKSIZE
_READABLE = 0o644


class Recordings:
    """The recordings of one unit, as HTTP gives them."""

    def __init__(self, service: RecordingService, guard: Guard, downloads: Downloads) -> None:
        self._service = service
        self._guard = guard
        self._downloads = downloads

    async def listed(self, _: Request) -> Response:
        """The fault recordings."""
        kept = [recording.as_object() for recording in self._service.recordings]
        return JSONResponse({"unavailable": self._service.unavailable, "recordings": kept})

    async def keep(self, request: Request) -> Response:
        """Keep the last seconds, for clients that may act."""
        by = self._guard.requester(request)
        kept = await self._service.provider.keep(f"asked by {by}")
        return JSONResponse(kept.as_object(), status_code=201)

    async def mark(self, request: Request) -> Response:
        """``PUT`` marks, ``DELETE`` takes the mark away, for clients that may act."""
        self._guard.actor(request)
        name = self._known_name(request)
        kept = await self._service.provider.mark(name, request.method == "PUT")
        return JSONResponse(kept.as_object())

    async def archive(self, request: Request) -> Response:
        """A recording as a tar archive, for clients that may see pictures."""
        self._guard.check_may_look(request)
        name = self._known_name(request)
        files = await self._service.provider.files(name)
        if request.method == "HEAD":
            return Response(media_type=_TAR)

        async def made() -> Response:
            named = saved_as(f"{name}.tar")
            return StreamingResponse(
                _tar(self._service.provider, name, files), media_type=_TAR, headers=named
            )

        return Download(self._downloads, made)

    def _known_name(self, request: Request) -> str:
        """The recording that the path names, one of the list; raises Refused."""
        name = str(request.path_params["name"])
        if all(name != recording.name for recording in self._service.recordings):
            raise Refused(refusal(404, "there is no such recording"))
        return name


async def _tar(keeper: RecordingKeeper, name: str, files: Sequence[str]) -> AsyncIterator[bytes]:
    """The files of a recording as a POSIX tar archive (ustar); one that goes meanwhile is left out.

    A disk that hangs ends it before ``recording.json``, the last: what has come then is no recording.
    """
    for file in files:
        try:
            content = await keeper.content(name, file)
        except NotKeptError:
            return
        if content is None:
            continue
        entry = tarfile.TarInfo(f"{name}/{file}")
        entry.size, entry.mode = len(content), _READABLE
        yield entry.tobuf(tarfile.USTAR_FORMAT)
        for begin in range(0, len(content), PIECE_BYTES):
            yield content[begin : begin + PIECE_BYTES]
        yield bytes(-len(content) % _BLOCK)
    yield bytes(2 * _BLOCK)
