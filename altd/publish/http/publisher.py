"""The interface: its settings, its sockets, its application."""

from __future__ import annotations

import asyncio
import errno
import json
import logging
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path

from altd.config import HttpSettings
from altd.credentials.certificates import RenewedContext, server_context
from altd.credentials.file import CredentialsKeeper
from altd.history.history import History
from altd.local_socket import identity_at, listening
from altd.publish.http.answers import Answers
from altd.publish.http.api_page import api_page_of
from altd.publish.http.application import application_of
from altd.publish.http.guard import Guard
from altd.publish.http.limits import REQUESTS, Allowed, OwnNames
from altd.publish.http.openapi import document_of
from altd.publish.http.past import Past
from altd.publish.http.paths import PATHS
from altd.publish.http.server import ConnectionPolicy, listen, serve
from altd.status.board import Board
from altd.status.event_log import EventLog
from altd.status.health import Component, Health, State
from altd.tcp_port import CONNECTIONS, Buckets

log = logging.getLogger("altd")

_LOOK_INTERVAL_S = 1.0
"""Interval at which the socket's file is checked; clients cannot connect without it."""


class HttpPublisher:
    """Serves the unit's page and its API.

    Raises BadInputError for credentials or a certificate that cannot be used.
    """

    is_local = False
    """Whether a file's permissions say who may connect, and he may what the unit's own computer may."""

    def __init__(
        self,
        settings: HttpSettings,
        board: Board,
        health: Health,
        component: Component,
        history: History | None = None,
        events: EventLog | None = None,
    ) -> None:
        self.port = settings.port
        """The address in use; for port 0, the port that the system chose."""
        self._settings = settings
        self._component = component
        self._place = ""
        self._complaints: dict[str, str] = {}
        keeper = certificate = None
        if settings.credentials is not None:
            keeper = CredentialsKeeper(settings.credentials, partial(self._complain, "credentials"))
        if settings.certificate is not None and settings.key is not None:
            complain = partial(self._complain, "certificate")
            files = settings.certificate, settings.key
            certificate = RenewedContext(
                partial(server_context, *files, protocols=("http/1.1",)), files, complain
            )
        known = None if keeper is None else keeper.current
        guard = Guard(known, component.clock, events, is_local=self.is_local)
        self._policy = ConnectionPolicy(
            Allowed(settings.allow), certificate, Buckets(CONNECTIONS, component.clock)
        )
        # over TLS the browser itself compares the name with the certificate
        is_open = certificate is None and not self.is_local
        self._names = OwnNames(settings.names) if is_open else None
        past = Past(history or History(None, "there is no history"), board.quantities, component.clock)
        self.answers = Answers(board, health, component, guard, past)
        document = document_of(PATHS, board.quantities, health.facts.get("version", ""))
        self.answers.document = json.dumps(document).encode()
        self.answers.api_page = api_page_of(document)

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError when the address cannot be had."""
        with listen(self._settings) as listener:
            self.port = listener.getsockname()[1]
            await self.serve(listener, f"port {self.port}{_openness(self._settings)}", ready)

    async def serve(self, listener: socket.socket, place: str, ready: Callable[[], None]) -> None:
        """Serve who connects there until cancelled; ``place`` is what health says."""
        self._place = place

        def serving() -> None:
            ready()
            self._tell()

        requests = Buckets(REQUESTS, self._component.clock)
        application = application_of(PATHS, self.answers, self._component, requests, self._names)
        await serve(application, listener, self._component, self._policy, serving)

    def _complain(self, about: str, sentence: str) -> None:
        """A file that was changed cannot be used; with an empty sentence, it can again."""
        self._complaints.pop(about, None)
        if sentence:
            self._complaints[about] = sentence
            log.warning("%s: %s", self._component.name, sentence)
        self._tell()

    def _tell(self) -> None:
        wrong = "; ".join(self._complaints.values())
        self._component.set_state(State.DEGRADED if wrong else State.OK, wrong or self._place)


def _openness(settings: HttpSettings) -> str:
    """Which networks can read here, in words: advice, and no fault."""
    own = settings.host == "localhost" or settings.host == "::1" or settings.host.startswith("127.")
    parts = [
        "with TLS" if settings.certificate is not None else "",
        "" if own or settings.allow else "open to every network that reaches it",
    ]
    return "".join(f", {part}" for part in parts if part)


class LocalPublisher(HttpPublisher):
    """Serves the unit's own computer; who may open the file may act, too."""

    is_local = True

    def __init__(
        self,
        path: Path,
        board: Board,
        health: Health,
        component: Component,
        history: History | None = None,
    ) -> None:
        super().__init__(HttpSettings(), board, health, component, history)
        self._path = path

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError when the socket cannot be had, or has lost its file."""
        with listening(self._path) as listener:
            made = identity_at(self._path)
            serving = asyncio.ensure_future(self.serve(listener, "for this computer alone", ready))
            try:
                while not (await asyncio.wait({serving}, timeout=_LOOK_INTERVAL_S))[0]:
                    if identity_at(self._path) != made:
                        raise OSError(errno.ENOENT, "the file of the socket was deleted or replaced")
                await serving
            finally:
                serving.cancel()
                await asyncio.gather(serving, return_exceptions=True)
