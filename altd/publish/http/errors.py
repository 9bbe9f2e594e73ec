"""Errors of this interface: a JSON object with ``error``, or a page for a browser that uses a wrong name."""

from __future__ import annotations

import html
import json
from collections.abc import Awaitable, Callable, Mapping
from http import HTTPStatus

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response

from altd.errors import did_you_mean, one_line
from altd.history.history import NoHistoryError
from altd.publish.http.models import Error
from altd.status.services import NoCalibrationFileError, NoReportError, NoSelfCheckError, NotKeptError

_STATUSES = {
    NoHistoryError: 503,
    NoReportError: 404,
    NoCalibrationFileError: 409,
    NoSelfCheckError: 409,
    NotKeptError: 409,
}
"""Status codes for requests that the unit cannot meet now; the error's text gives the reason."""


class Refused(Exception):  # noqa: N818  a response, not a fault
    """A request is refused; ``answer`` is the response."""

    def __init__(self, answer: Response) -> None:
        super().__init__(answer.status_code)
        self.answer = answer


def refusal(status: int, sentence: str, headers: Mapping[str, str] | None = None) -> Response:
    """Return an error as the response to a request."""
    return JSONResponse(Error(error=sentence).as_object(), status_code=status, headers=headers)


def error_body(sentence: str) -> bytes:
    """Return the same object as bytes, for requests that do not reach the application."""
    return json.dumps(Error(error=sentence).as_object(), separators=(",", ":")).encode()


def misdirected(host: str, address: str, accepts_page: bool) -> Response:
    """Return the response to a wrong name in ``Host``; ``address`` is an address of the unit."""
    name = one_line(host)
    if not accepts_page:
        sentence = (
            f"the name {name!r} in Host is not a name of this unit: use its address, or add the name to"
        )
        return refusal(421, f"{sentence} `names` in [http] of its config")
    name, link = html.escape(name), html.escape(f"http://{address}/")
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>altd: {name}</title>'
        f"<h1>The unit does not answer by the name {name}</h1>"
        f'<p>Open it by its address: <a href="{link}">{link}</a></p>'
        "<p>To allow the name, add it to the unit's config and restart altd:</p>"
        f"<pre>[http]\nnames = [&quot;{name}&quot;]</pre>"
    )
    return HTMLResponse(page, 421, {"Content-Security-Policy": "default-src 'none'"})


async def _of_defect(_: Request, __: Exception) -> Response:
    """Return 500 for any failure of a handler, such as a number that JSON cannot represent."""
    return refusal(500, "a defect of the unit; its log has the details")


async def _of_routing(request: Request, error: Exception) -> Response:
    """Return starlette's 404 or 405; a 404 names the path and the most similar existing one."""
    assert isinstance(error, HTTPException)  # noqa: S101  registered for this type only
    if error.status_code == HTTPStatus.NOT_FOUND:
        path = request.url.path
        paths = [route.path for route in request.app.routes if "{" not in route.path]
        near = did_you_mean(path, paths)
        return refusal(404, f"there is no {one_line(path)}{near}; /api/v1/ lists the paths")
    return refusal(error.status_code, error.detail, error.headers)


async def _of_refused(_: Request, error: Exception) -> Response:
    assert isinstance(error, Refused)  # noqa: S101  registered for this type only
    return error.answer


def _with_status(status: int) -> Callable[[Request, Exception], Awaitable[Response]]:
    async def answer(_: Request, error: Exception) -> Response:
        return refusal(status, str(error))

    return answer


HANDLERS: dict[type[Exception], Callable[[Request, Exception], Awaitable[Response]]] = {
    HTTPException: _of_routing,
    Exception: _of_defect,
    Refused: _of_refused,
    **{kind: _with_status(status) for kind, status in _STATUSES.items()},
}
"""Handlers by exception type; each returns the response to an exception from a path's handler."""
