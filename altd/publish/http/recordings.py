"""Recordings that the unit has kept: their list for everybody, themselves for who may see pictures."""

from __future__ import annotations

import tarfile
from collections.abc import AsyncIterator, Sequence

from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from altd.publish.http.errors import refusal
from altd.publish.http.guard import THIS_COMPUTER, Guard, Refused
from altd.status.recording_desk import NotKeptError, RecordingDesk, RecordingKeeper

MAX_DOWNLOADS = 2
"""Archives that are sent at a time."""

_BLOCK = tarfile.BLOCKSIZE
_PIECE_BYTES = 1 << 18
_READABLE = 0o644


class Recordings:
    """The recordings of one unit, as HTTP gives them."""

    def __init__(self, desk: RecordingDesk, guard: Guard) -> None:
        self._desk = desk
        self._guard = guard
        self.downloads = 0

    def listed(self) -> Response:
        """What there is."""
        kept = [recording.as_object() for recording in self._desk.recordings]
        return JSONResponse({"unavailable": self._desk.unavailable, "recordings": kept})

    async def keep(self, request: Request) -> Response:
        """Keep the last seconds, for who may act."""
        try:
            actor = self._guard.actor(request)
            host = "" if request.client is None else f" {request.client.host}"
            by = f"asked by http{host}{'' if actor == THIS_COMPUTER else f', {actor}'}"
            kept = await self._desk.keeper.keep(by)
        except Refused as refused:
            return refused.answer
        except NotKeptError as error:
            return refusal(409, str(error))
        return JSONResponse(kept.as_object(), status_code=201)

    async def mark(self, request: Request) -> Response:
        """``PUT`` marks, ``DELETE`` takes the mark away, for who may act."""
        try:
            self._guard.actor(request)
            name = self._known_name(request)
            kept = await self._desk.keeper.mark(name, request.method == "PUT")
        except Refused as refused:
            return refused.answer
        except NotKeptError as error:
            return refusal(409, str(error))
        return JSONResponse(kept.as_object())

    async def archive(self, request: Request) -> Response:
        """A recording as a tar archive, for who may see pictures."""
        try:
            self._guard.check_may_look(request)
            name = self._known_name(request)
            files = await self._desk.keeper.files(name)
        except Refused as refused:
            return refused.answer
        except NotKeptError as error:
            return refusal(409, str(error))
        if request.method == "HEAD":
            return Response(media_type=_Archive.media_type)
        if self.downloads >= MAX_DOWNLOADS:
            return refusal(503, f"{MAX_DOWNLOADS} recordings are being fetched already")
        return _Archive(self, self._desk.keeper, name, files)

    def _known_name(self, request: Request) -> str:
        """The recording that the path names, one of the list; raises Refused."""
        name = str(request.path_params["name"])
        if all(name != recording.name for recording in self._desk.recordings):
            raise Refused(refusal(404, "there is no such recording"))
        return name


class _Archive(StreamingResponse):
    """A recording, sent as fast as it is taken; a client that goes away ends it."""

    media_type = "application/x-tar"

    def __init__(
        self, recordings: Recordings, keeper: RecordingKeeper, name: str, files: Sequence[str]
    ) -> None:
        self._recordings = recordings
        named = {"Content-Disposition": f'attachment; filename="{name}.tar"'}
        super().__init__(_tar(keeper, name, files), headers=named)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it."""
        self._recordings.downloads += 1
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._recordings.downloads -= 1


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
        for begin in range(0, len(content), _PIECE_BYTES):
            yield content[begin : begin + _PIECE_BYTES]
        yield bytes(-len(content) % _BLOCK)
    yield bytes(2 * _BLOCK)
