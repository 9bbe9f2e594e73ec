"""Recordings that the unit has kept: their list for everybody, themselves for who may see pictures."""

from __future__ import annotations

import tarfile
from collections.abc import AsyncIterator, Sequence

from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse

from altd.publish.http.downloads import PIECE_BYTES, Downloads, saved_as
from altd.publish.http.errors import refusal
from altd.publish.http.guard import THIS_COMPUTER, Guard, Refused
from altd.status.recording_desk import NotKeptError, RecordingDesk, RecordingKeeper

_TAR = "application/x-tar"
_BLOCK = tarfile.BLOCKSIZE
_READABLE = 0o644


class Recordings:
    """The recordings of one unit, as HTTP gives them."""

    def __init__(self, desk: RecordingDesk, guard: Guard, downloads: Downloads) -> None:
        self._desk = desk
        self._guard = guard
        self._downloads = downloads

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
            return Response(media_type=_TAR)

        async def made() -> Response:
            named = saved_as(f"{name}.tar")
            return StreamingResponse(_tar(self._desk.keeper, name, files), media_type=_TAR, headers=named)

        return self._downloads.of(made)

    def _known_name(self, request: Request) -> str:
        """The recording that the path names, one of the list; raises Refused."""
        name = str(request.path_params["name"])
        if all(name != recording.name for recording in self._desk.recordings):
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
