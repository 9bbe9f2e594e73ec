"""Recordings that the unit has kept; making and sending of large responses, a few at a time."""

from __future__ import annotations

import re
import tarfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence

from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from altd.publish.http import models
from altd.publish.http.errors import Refused, refusal
from altd.publish.http.guard import Guard
from altd.status.services import NotKeptError, RecordingKeeper, RecordingService

MAX_DOWNLOADS = 2
"""Maximum number of recordings, diagnostics, calibration files and reports made or sent at a time."""

PIECE_BYTES = 1 << 18
"""Size of the pieces in which a response is sent: only one waits for the client."""

_NOT_IN_A_NAME = re.compile(r"[^0-9A-Za-z._-]")


class Downloads:
    """Number of active downloads of one interface."""

    def __init__(self) -> None:
        self.open = 0


class Download(Response):
    """The response that ``make`` returns; 503 if too many downloads are active.

    It is active from before it is made until it is sent or the client has disconnected.
    """

    def __init__(self, downloads: Downloads, make: Callable[[], Awaitable[Response]]) -> None:
        super().__init__()
        self._downloads = downloads
        self._make = make

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Make and send the response."""
        if self._downloads.open >= MAX_DOWNLOADS:
            await refusal(503, f"{MAX_DOWNLOADS} downloads are under way already")(scope, receive, send)
            return
        self._downloads.open += 1
        try:
            await (await self._make())(scope, receive, send)
        finally:
            self._downloads.open -= 1


def sent_whole(content: bytes, media_type: str, headers: Mapping[str, str]) -> Response:
    """Return a response that is active until the client has received all of it but the last piece."""

    async def pieces() -> AsyncIterator[bytes]:
        for begin in range(0, len(content), PIECE_BYTES):
            yield content[begin : begin + PIECE_BYTES]

    sized = {**headers, "Content-Length": str(len(content))}
    return StreamingResponse(pieces(), media_type=media_type, headers=sized)


def head_of(media_type: str, headers: Mapping[str, str] | None = None) -> Response:
    """Return the response to HEAD for a body whose length is not known yet: without Content-Length."""
    response = Response(headers=headers, media_type=media_type)
    del response.headers["Content-Length"]
    return response


def saved_as(name: str) -> dict[str, str]:
    """Return the header to save the response under this name, in characters that any system accepts."""
    return {"Content-Disposition": f'attachment; filename="{_NOT_IN_A_NAME.sub("_", name)}"'}


_TAR = "application/x-tar"
_BLOCK = tarfile.BLOCKSIZE
_READABLE = 0o644


class Recordings:
    """Answers requests for the recordings of one unit."""

    def __init__(self, service: RecordingService, guard: Guard, downloads: Downloads) -> None:
        self._service = service
        self._guard = guard
        self._downloads = downloads

    async def listed(self, _: Request) -> Response:
        """Return the list of recordings."""
        kept = list(self._service.recordings)
        shown = models.Recordings(unavailable=self._service.unavailable, recordings=kept)
        return JSONResponse(shown.as_object())

    async def keep(self, request: Request) -> Response:
        """Keep the last seconds as a recording, for clients that may act."""
        by = self._guard.requester(request)
        kept = await self._service.provider.keep(f"asked by {by}")
        place = {"Location": f"recordings/{kept.name}"}  # relative: a proxy may add a prefix
        return JSONResponse(kept.as_object(), status_code=201, headers=place)

    async def mark(self, request: Request) -> Response:
        """Mark a recording (``PUT``), or remove its mark (``DELETE``), for clients that may act."""
        self._guard.actor(request)
        name = self._known_name(request)
        kept = await self._service.provider.mark(name, request.method == "PUT")
        return JSONResponse(kept.as_object())

    async def archive(self, request: Request) -> Response:
        """Return a recording as a tar archive, for clients that may see pictures."""
        self._guard.check_may_look(request)
        name = self._known_name(request)
        files = await self._service.provider.files(name)
        if request.method == "HEAD":
            return head_of(_TAR)

        async def made() -> Response:
            named = saved_as(f"{name}.tar")
            return StreamingResponse(
                _tar(self._service.provider, name, files), media_type=_TAR, headers=named
            )

        return Download(self._downloads, made)

    def _known_name(self, request: Request) -> str:
        """Return the name of the recording in the path; raises Refused if it is not in the list."""
        name = str(request.path_params["name"])
        if all(name != recording.name for recording in self._service.recordings):
            raise Refused(refusal(404, "there is no such recording"))
        return name


async def _tar(keeper: RecordingKeeper, name: str, files: Sequence[str]) -> AsyncIterator[bytes]:
    """Yield the files of a recording as a POSIX tar archive (ustar), without files deleted meanwhile.

    If the disk hangs, it ends before ``recording.json``, the last file, and is therefore no recording.
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
