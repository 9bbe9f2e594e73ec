"""What answers HTTP: read-only, each answer from one reading of the board."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from altd.config import HttpSettings
from altd.publish.http.page import page_of
from altd.publish.http.server import listen, serve
from altd.publish.http.stream import EventStream, Streams
from altd.reasons import Reason
from altd.status.board import Board
from altd.status.health import Component, Health, State
from altd.status.measurement_json import as_line

_PAGE_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; "
    "img-src data:; frame-ancestors 'none'"
)
"""The page may load nothing but its own unit's answers."""

NOTHING_YET = {
    "error": "nothing was measured since the unit started; /api/status says what it waits for",
    "status": [str(Reason.WARMING_UP)],
}


class HttpPublisher:
    """Serves the unit's page and its API."""

    def __init__(self, settings: HttpSettings, board: Board, health: Health, component: Component) -> None:
        self.port = settings.port
        """Where it serves; for port 0, what the system chose."""
        self._settings = settings
        self._board = board
        self._health = health
        self._component = component
        self._streams = Streams(board, component)
        self._page = page_of(board.quantities)

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError when the address cannot be had."""

        def serving() -> None:
            ready()
            self._component.say(State.OK, f"port {self.port}")

        with listen(self._settings) as listener:
            self.port = listener.getsockname()[1]
            await serve(self._application(), listener, self._component, serving)

    async def index(self, _: Request) -> Response:
        """The page."""
        return HTMLResponse(self._page, headers={"Content-Security-Policy": _PAGE_POLICY})

    async def measurement(self, _: Request) -> Response:
        """The latest measurement."""
        self._component.count("requests")
        measurement = self._board.read()
        if measurement is None:
            return JSONResponse(NOTHING_YET, status_code=503)
        self._component.gave_data()
        return Response(as_line(measurement), media_type="application/json")

    async def status(self, _: Request) -> Response:
        """The unit's facts and its components."""
        self._component.count("requests")
        return JSONResponse(self._health.as_object())

    async def stream(self, request: Request) -> Response:
        """Measurements as they come."""
        if request.method == "HEAD":
            return Response(media_type=EventStream.media_type)
        return EventStream(self._streams)

    def _application(self) -> Starlette:
        application = Starlette(
            routes=[Route(path.path, path.answer.__get__(self)) for path in PATHS],
            exception_handlers={HTTPException: _refusal},
        )
        application.router.redirect_slashes = False
        return application


@dataclass(frozen=True, slots=True)
class ServedPath:
    """One path that is served."""

    path: str
    answer: Callable[[HttpPublisher, Request], Awaitable[Response]]
    gives: str


PATHS = (
    ServedPath("/", HttpPublisher.index, "a page for a person: the values live, their validity, links"),
    ServedPath("/api/measurement", HttpPublisher.measurement, "the latest measurement, one JSON object"),
    ServedPath(
        "/api/status", HttpPublisher.status, "the unit and the state of its components, one JSON object"
    ),
    ServedPath("/api/stream", HttpPublisher.stream, "every measurement as it comes, server-sent events"),
)


async def _refusal(_: Request, error: Exception) -> Response:
    """404 and 405 in JSON."""
    assert isinstance(error, HTTPException)  # noqa: S101  it is registered for no other
    return JSONResponse({"error": error.detail}, status_code=error.status_code, headers=error.headers)
