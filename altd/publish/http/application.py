"""The application: the paths with their answers, behind a gate that every request passes."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Iterable

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send

from altd.publish.http import errors
from altd.publish.http.answers import Answers
from altd.publish.http.errors import misdirected, refusal
from altd.publish.http.guard import too_many
from altd.publish.http.limits import OwnNames, host_of
from altd.publish.http.operations import ServedPath
from altd.publish.http.paths import ALIVE
from altd.publish.http.pictures import PATH
from altd.status.health import Component
from altd.tcp_port import Buckets, address_of, group_of, is_loopback

log = logging.getLogger("altd")

MAX_TARGET_BYTES = 2048
"""Of a path with its query."""

_SINGLE_HEADERS = (b"authorization", b"content-length", b"content-type", b"cookie", b"host", b"origin")
"""Of two of them one program reads the first and another one the last."""


def application_of(
    paths: Iterable[ServedPath],
    answers: Answers,
    component: Component,
    requests: Buckets,
    names: OwnNames | None = None,
) -> ASGIApp:
    """The application that answers every request, over TCP and the local socket.

    ``requests`` limits how often an address may ask.
    ``names`` are those that the unit may be asked by; None: any.
    """
    routes: list[BaseRoute] = [
        Route(path.path, _handler(path, answers), methods=list(path.operations)) for path in paths
    ]
    routes.append(Route("/page/{file:path}", answers.page_file, methods=["GET"]))
    routes.append(WebSocketRoute(PATH, answers.viewers.show))
    handlers = {HTTPException: errors.of_routing, Exception: errors.of_defect}
    routed = Starlette(routes=routes, exception_handlers=handlers)
    routed.router.redirect_slashes = False
    return _Gate(routed, component, requests, names)


def _handler(path: ServedPath, answers: Answers) -> Callable[[Request], Awaitable[Response]]:
    """One for all methods of a path: starlette would name only the first route's in ``Allow``."""

    async def handle(request: Request) -> Response:
        method = "GET" if request.method == "HEAD" else request.method
        return await path.operations[method].handler(answers, request)

    return handle


class _Gate:
    """Checks before any path: one meaning, addressed to this unit, within the limit of rate."""

    def __init__(
        self, application: ASGIApp, component: Component, requests: Buckets, names: OwnNames | None
    ) -> None:
        self._names = names
        self._application = application
        self._component = component
        self._requests = requests

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse, or pass on."""
        self._component.count("requests")
        if (wait_s := self._wait_s(scope)) > 0:
            self._component.count("requests_limited")
            answer: ASGIApp = too_many("too many requests", wait_s)
        else:
            answer = _malformed(scope) or self._misdirected(scope) or self._application
        try:
            await answer(scope, receive, send)
        except Exception:
            if scope["type"] != "http":  # uvicorn ends a WebSocket
                raise
            log.exception("%s: a defect", self._component.name)

    def _misdirected(self, scope: Scope) -> Response | None:
        """Why it is not for this unit, by its ``Host``; None: it is, or it only asks whether it lives."""
        hosts = [value.decode("latin-1") for name, value in scope["headers"] if name == b"host"]
        if self._names is None or scope["path"] == ALIVE or all(host in self._names for host in hosts):
            return None
        self._component.count("requests_misdirected")
        accepted = b",".join(value for name, value in scope["headers"] if name == b"accept")
        address, port = scope.get("server") or ("", None)
        address = f"[{address}]" if ":" in address else address
        return misdirected(host_of(hosts[0]), f"{address}:{port}", b"text/html" in accepted)

    def _wait_s(self, scope: Scope) -> float:
        """Time that the sender has to wait; 0 for the unit's own computer, which has no limit."""
        client = scope.get("client")
        address = None if client is None else address_of(client[0])
        if address is None or is_loopback(address):
            return 0.0
        return self._requests.take(group_of(address))


def _malformed(scope: Scope) -> Response | None:
    """Why a request is none that we answer; None: it may be.

    No path of ours needs a percent sign: one that is written with it is read differently by what may be
    before us. A body has no two lengths (RFC 9112, 6.1), and a header of one value comes once.
    """
    raw_path: bytes = scope["raw_path"]
    if len(raw_path) + len(scope["query_string"]) > MAX_TARGET_BYTES:
        return refusal(414, f"the path with its query is longer than {MAX_TARGET_BYTES} bytes")
    if b"%" in raw_path:
        return refusal(404, "Not Found")
    names = [name for name, _ in scope["headers"]]
    if b"transfer-encoding" in names and b"content-length" in names:
        return refusal(400, "its body has two lengths")
    if any(names.count(name) > 1 for name in _SINGLE_HEADERS):
        return refusal(400, "a header that comes once comes twice")
    return None
