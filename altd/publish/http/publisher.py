"""The HTTP interface: its settings and sockets, and its application behind the checks of every request."""

from __future__ import annotations

import asyncio
import errno
import json
import logging
import re
import socket
from collections.abc import Awaitable, Callable
from functools import cache, partial
from pathlib import Path

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send

from altd.config import HttpSettings
from altd.credentials.certificates import RenewedContext, server_context
from altd.credentials.file import CredentialsKeeper
from altd.history.history import History
from altd.local_socket import identity_at, listening
from altd.publish.http.answers import Answers, Description
from altd.publish.http.clients import REQUESTS, Allowed, OwnNames, host_of
from altd.publish.http.compression import compressed
from altd.publish.http.errors import HANDLERS, misdirected, refusal
from altd.publish.http.guard import Guard, too_many
from altd.publish.http.openapi import api_page_of, document_of
from altd.publish.http.operations import ServedPath
from altd.publish.http.past import Past
from altd.publish.http.paths import ALIVE, PATHS
from altd.publish.http.pictures import PATH
from altd.publish.http.server import ConnectionPolicy, listen, serve
from altd.records import Quantities
from altd.status.event_log import EventLog
from altd.status.health import Component, State
from altd.status.unit import PublishedUnit
from altd.tcp_port import CONNECTIONS, Buckets, address_of, group_of, is_loopback

log = logging.getLogger("altd")

_LOOK_INTERVAL_S = 1.0
"""Interval at which the socket's file is checked; clients cannot connect without it."""

MAX_TARGET_BYTES = 2048
"""Maximum length of a path with its query."""

_SINGLE_HEADERS = (b"authorization", b"content-length", b"content-type", b"cookie", b"host", b"origin")
"""Headers that must not be repeated: of two, one program reads the first and another one the last."""


_HOST = re.compile(rb"(\[[0-9A-Fa-f:.]+\]|[^\s\[\]:/?#@]*)(:\d*)?")
"""A valid value of ``Host``: name or address, and port (RFC 9110, 7.2)."""


def application_of(
    answers: Answers, component: Component, requests: Buckets, names: OwnNames | None
) -> ASGIApp:
    """Return the application that answers every request, over TCP and the local socket.

    ``requests`` limits the rate of requests per address.
    ``names`` are the names of the unit that are accepted in ``Host``; None: any.
    """
    routes: list[BaseRoute] = [
        Route(path.path, _handler(path, answers), methods=list(path.operations)) for path in PATHS
    ]
    routes.append(Route("/page/{file:path}", answers.page_file, methods=["GET"]))
    routes.append(Route("/screen", answers.screen, methods=["GET"]))
    routes += [WebSocketRoute(PATH, answers.viewers.show), Route(PATH, _needs_websocket, methods=["GET"])]
    routed = Starlette(routes=routes, exception_handlers=HANDLERS)
    routed.router.redirect_slashes = False
    return _Gate(routed, component, requests, names)


async def _needs_websocket(_: Request) -> Response:
    return refusal(426, "pictures are sent over a WebSocket", {"Upgrade": "websocket"})


def _handler(path: ServedPath, answers: Answers) -> Callable[[Request], Awaitable[Response]]:
    """Return one handler for all methods of a path: starlette's ``Allow`` has only the first route's."""

    async def handle(request: Request) -> Response:
        method = "GET" if request.method == "HEAD" else request.method
        return compressed(request, await path.operations[method].handler(answers, request))

    return handle


class _Gate:
    """Checks every request: unambiguous, addressed to this unit, within the rate limit."""

    def __init__(
        self, application: ASGIApp, component: Component, requests: Buckets, names: OwnNames | None
    ) -> None:
        self._names = names
        self._application = application
        self._component = component
        self._requests = requests

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request, or forward it to the application."""
        self._component.count("requests")
        scope = _in_origin_form(scope)
        if (wait_s := self._wait_s(scope)) > 0:
            self._component.count("requests_limited")
            answer: ASGIApp = too_many("too many requests", wait_s)
        else:
            answer = _malformed(scope) or self._misdirected(scope) or self._application
        try:
            await answer(scope, receive, send)
        except Exception:
            if scope["type"] != "http":  # uvicorn itself ends a WebSocket
                raise
            log.exception("%s: a defect", self._component.name)

    def _misdirected(self, scope: Scope) -> Response | None:
        """Return a refusal if ``Host`` is not a name of this unit; None: it is, or it is a liveness check."""
        hosts = [value.decode("latin-1") for name, value in scope["headers"] if name == b"host"]
        if self._names is None or scope["path"] == ALIVE or all(host in self._names for host in hosts):
            return None
        self._component.count("requests_misdirected")
        accepted = b",".join(value for name, value in scope["headers"] if name == b"accept")
        address, port = scope.get("server") or ("", None)
        address = f"[{address}]" if ":" in address else address
        return misdirected(host_of(hosts[0]), f"{address}:{port}", b"text/html" in accepted)

    def _wait_s(self, scope: Scope) -> float:
        """Time that the client has to wait, s; 0 for the unit's own computer, which has no limit."""
        client = scope.get("client")
        address = None if client is None else address_of(client[0])
        if address is None or is_loopback(address):
            return 0.0
        return self._requests.take(group_of(address))


def _in_origin_form(scope: Scope) -> Scope:
    """Return a request whose target is a whole URL as one with a path (RFC 9112, 3.2.2).

    The URL replaces ``Host``.
    """
    scheme, is_url, rest = scope["raw_path"].partition(b"://")
    if not is_url or scheme.lower() != scope["scheme"].encode():
        return scope
    host, _, path = rest.partition(b"/")
    others = [(name, value) for name, value in scope["headers"] if name != b"host"]
    path = b"/" + path
    about = {"raw_path": path, "path": path.decode("latin-1"), "headers": [(b"host", host), *others]}
    return {**scope, **about}


def _malformed(scope: Scope) -> Response | None:
    """Return the refusal of an oversized or ambiguous request; None: it is acceptable.

    No path of ours needs a percent sign, which a proxy before us may read differently. A body must not have
    two lengths (RFC 9112, 6.1), and a header with one value must not be repeated.
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
        return refusal(400, "a header that must be unique occurs twice")
    if not all(_HOST.fullmatch(value) for name, value in scope["headers"] if name == b"host"):
        return refusal(400, "its Host is no name or address with a port")
    if not scope["http_version"].startswith("1."):
        return refusal(505, "only HTTP/1.1 and HTTP/1.0 are spoken")
    return None


@cache
def _description_of(quantities: Quantities, version: str) -> Description:
    """Return the description, one for all interfaces of the daemon."""
    document = document_of(PATHS, quantities, version)
    return Description(json.dumps(document).encode(), api_page_of(document))


class HttpPublisher:
    """Serves the unit's page and its API.

    Raises BadInputError for credentials or a certificate that cannot be used.
    """

    is_local = False
    """Whether a file's permissions control access; clients may then do what the unit's own computer may."""

    def __init__(
        self,
        settings: HttpSettings,
        unit: PublishedUnit,
        component: Component,
        history: History | None = None,
        events: EventLog | None = None,
    ) -> None:
        self.port = settings.port
        """Port in use; for port 0, the port that the system chose, once it listens."""
        self._settings = settings
        self._component = component
        self._place = ""
        self._complaints: dict[str, str] = {}
        keeper = certificate = None
        if settings.credentials is not None:
            keeper = CredentialsKeeper(settings.credentials, partial(self._report_error, "credentials"))
        if settings.certificate is not None and settings.key is not None:
            report_error = partial(self._report_error, "certificate")
            files = settings.certificate, settings.key
            certificate = RenewedContext(
                partial(server_context, *files, protocols=("http/1.1",)), files, report_error
            )
        known = None if keeper is None else keeper.current
        guard = Guard(known, component.clock, events, is_local=self.is_local)
        self._policy = ConnectionPolicy(
            Allowed(settings.allow), certificate, Buckets(CONNECTIONS, component.clock)
        )
        # over TLS the browser itself compares the name with the certificate
        is_open = certificate is None and not self.is_local
        self._names = OwnNames(settings.names) if is_open else None
        quantities = unit.board.quantities
        past = Past(history or History(None, "there is no history"), quantities, component.clock)
        description = _description_of(quantities, unit.facts.version)
        self.answers = Answers(unit, component, guard, past, description)

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError if the address is not available."""
        with listen(self._settings) as listener:
            self.port = listener.getsockname()[1]
            await self.serve(listener, f"port {self.port}{_openness(self._settings)}", ready)

    async def serve(self, listener: socket.socket, place: str, ready: Callable[[], None]) -> None:
        """Serve the clients of ``listener`` until cancelled; ``place`` describes it in the health report."""
        self._place = place

        def serving() -> None:
            ready()
            self._set_state()

        requests = Buckets(REQUESTS, self._component.clock)
        application = application_of(self.answers, self._component, requests, self._names)
        await serve(application, listener, self._component, self._policy, serving)

    def _report_error(self, about: str, sentence: str) -> None:
        """Report that a changed file cannot be used, or, with an empty sentence, that it can be again."""
        self._complaints.pop(about, None)
        if sentence:
            self._complaints[about] = sentence
            log.warning("%s: %s", self._component.name, sentence)
        self._set_state()

    def _set_state(self) -> None:
        wrong = "; ".join(self._complaints.values())
        self._component.set_state(State.DEGRADED if wrong else State.OK, wrong or self._place)


def _openness(settings: HttpSettings) -> str:
    """Return a text on TLS and on networks with access, as advice, not as a fault."""
    own = settings.host == "localhost" or settings.host == "::1" or settings.host.startswith("127.")
    parts = [
        "with TLS" if settings.certificate is not None else "",
        "" if own or settings.allow else "open to every network that reaches it",
    ]
    return "".join(f", {part}" for part in parts if part)


class LocalPublisher(HttpPublisher):
    """Serves the unit's own computer; clients that may open the socket's file may also act."""

    is_local = True

    def __init__(
        self, path: Path, unit: PublishedUnit, component: Component, history: History | None = None
    ) -> None:
        super().__init__(HttpSettings(), unit, component, history)
        self._path = path

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError if the socket is not available or has lost its file."""
        with listening(self._path) as listener:
            made = identity_at(self._path)
            serving = asyncio.ensure_future(self.serve(listener, "for this computer only", ready))
            try:
                while not (await asyncio.wait({serving}, timeout=_LOOK_INTERVAL_S))[0]:
                    if identity_at(self._path) != made:
                        raise OSError(errno.ENOENT, "the file of the socket was deleted or replaced")
                await serving
            finally:
                serving.cancel()
                await asyncio.gather(serving, return_exceptions=True)
