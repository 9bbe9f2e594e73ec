"""Requests to a running daemon through its local socket: once, at intervals, or for a self-check."""

from __future__ import annotations

import contextlib
import http.client
import os
import queue
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from altd.app.settings import socket_to_ask
from altd.config import Config
from altd.errors import BadInputError
from altd.files.documents import parse_json
from altd.files.table import NAME_PATTERN
from altd.instruments.beam.instrument import QUANTITIES as OF_BEAM
from altd.instruments.planar.instrument import QUANTITIES as OF_PLATE
from altd.instruments.row.measurement import quantities_of
from altd.local_socket import MAX_ANSWER_BYTES, NoAnswerError, ask
from altd.publish.http.clients import SELF_CHECK_WAIT_S
from altd.publish.http.guard import REQUEST_HEADER
from altd.records import Quantities
from altd.terminal.documents import (
    CalibrationDocument,
    SelfCheckDocument,
    ShownBeam,
    StatusDocument,
    TargetsDocument,
    checked,
    reading_of,
)
from altd.terminal.knowledge import Knowledge

Document = TypeVar("Document")

_MAX_TARGETS = 16
_NAME = re.compile(NAME_PATTERN)
_QUANTITIES = replace(OF_BEAM, of_unit=OF_BEAM.of_unit + OF_PLATE.of_unit)
"""Quantities of a beam and of a plate; a measurement has only those of its own instrument."""

_GOOD = (http.client.OK, http.client.SERVICE_UNAVAILABLE)
"""Accepted statuses. A request for a measurement gets 503 while there is none; other 503s have other keys."""


@dataclass(frozen=True, slots=True)
class RunningDaemon:
    """The daemon at a socket; each request ends within ``timeout_s`` and may raise NoAnswerError."""

    path: Path
    timeout_s: float

    def reading(self) -> tuple[ShownBeam | None, object]:
        """Request the latest measurement and its document; None: no measurement so far."""
        return self._document(
            "/api/v1/measurement", lambda document: reading_of(document, _quantities_of(document))
        )

    def status(self) -> tuple[StatusDocument, object]:
        """Request the unit's state, causes, availability and components, and the document."""
        return self._document("/api/v1/status", partial(checked, StatusDocument))

    def self_check(self) -> tuple[SelfCheckDocument, object]:
        """Request the last self-check and its document."""
        return self._document("/api/v1/self-check", partial(checked, SelfCheckDocument))

    def calibration(self) -> tuple[CalibrationDocument, object]:
        """Request the quality of the targets' calibration and its document."""
        return self._document("/api/v1/calibration", partial(checked, CalibrationDocument))

    def targets(self) -> tuple[TargetsDocument, object]:
        """Request the areas in which the targets are measured and their document."""
        return self._document("/api/v1/targets", partial(checked, TargetsDocument))

    def _document(self, target: str, read: Callable[[object], Document]) -> tuple[Document, object]:
        status, document = ask(self.path, target, self.timeout_s)
        if status not in _GOOD:
            raise NoAnswerError(f"the server at {self.path} has no {target}: it answers {status}")
        try:
            return read(document), document
        except ValueError as error:
            raise NoAnswerError(f"the server at {self.path} gives no usable {target}: {error}") from error


def _quantities_of(document: object) -> Quantities:
    """Return the quantities of a row if the document names targets, else of the other instruments."""
    targets = document.get("targets") if isinstance(document, dict) else None
    if not isinstance(targets, dict):
        return _QUANTITIES
    return quantities_of([name for name in list(targets)[:_MAX_TARGETS] if _NAME.fullmatch(name)])


_ANYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104  where the daemon listens on every address
_TARGET = "/api/self-check"
_HEADERS = {REQUEST_HEADER: "selfcheck"}
_TIMEOUT_S = SELF_CHECK_WAIT_S + 5.0


def ask_running_daemon(config: Config, place: Path) -> dict[str, Any]:
    """Request a check from the daemon with this config; return the document of ``/api/self-check``.

    Uses the local socket if there is one. Uses HTTP if there is none, as with a daemon started by hand, or if
    this user may not open it. Raises BadInputError for a config with neither, NoAnswerError if no check is
    possible.
    """
    status, document = _answer(config, place)
    if status == http.client.OK and isinstance(document, dict) and "verdict" in document:
        return document
    said = document.get("error") if isinstance(document, dict) else None
    raise NoAnswerError(said if isinstance(said, str) else f"the answer is {status}, not a verdict")


def _answer(config: Config, place: Path) -> tuple[int, Any]:
    path, said = socket_to_ask(config, place), ""
    if config.local is not None or os.path.lexists(path):
        try:
            return ask(path, _TARGET, _TIMEOUT_S, "POST", _HEADERS)
        except NoAnswerError as error:
            if config.http is None:
                raise
            said = f"{error}; "
    elif config.http is None:
        raise BadInputError(place, f"no [local] and no [http] table, and no socket {path}: nowhere to ask")
    try:
        return _ask_http(config.http.host, config.http.port)
    except NoAnswerError as error:
        raise NoAnswerError(f"{said}{error}") from error


def _ask_http(host: str, port: int) -> tuple[int, Any]:
    host = _ANYWHERE.get(host, host)
    connection = http.client.HTTPConnection(host, port, timeout=_TIMEOUT_S)
    try:
        connection.request("POST", _TARGET, headers=_HEADERS)
        with connection.getresponse() as answer:
            return answer.status, parse_json(answer.read(MAX_ANSWER_BYTES))
    except OSError as error:
        raise NoAnswerError(f"no daemon answers at {host} port {port}: {error.strerror or error}") from error
    except (http.client.HTTPException, ValueError) as error:
        raise NoAnswerError(f"the server at {host} port {port} is not an altd daemon: {error}") from error
    finally:
        connection.close()


READING_INTERVAL_S = 0.2
STATUS_INTERVAL_S = 0.5
DOCUMENTS_INTERVAL_S = 5.0
_MAX_UPDATES = 64
"""Maximum number of responses that wait for display; further ones are dropped."""

Update = Callable[[Knowledge], None]


class Follower:
    """Sends requests at intervals during its context; ``tell`` passes on the responses."""

    def __init__(self, daemon: RunningDaemon) -> None:
        self._daemon = daemon
        self._updates: queue.Queue[Update] = queue.Queue(_MAX_UPDATES)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="follow the daemon", daemon=True)

    def __enter__(self) -> Follower:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join(timeout=2 * self._daemon.timeout_s)

    def update(self, knowledge: Knowledge) -> None:
        """Pass on all responses since the last call."""
        with contextlib.suppress(queue.Empty):
            while True:
                self._updates.get_nowait()(knowledge)

    def _follow(self) -> None:
        due_status_s = due_documents_s = 0.0
        while not self._end.is_set():
            begun_s = time.monotonic()
            try:
                self._ask_reading()
                if begun_s >= due_documents_s:
                    self._ask_documents()
                    due_documents_s = begun_s + DOCUMENTS_INTERVAL_S
                if begun_s >= due_status_s:
                    self._ask_status()
                    due_status_s = begun_s + STATUS_INTERVAL_S
            except NoAnswerError as error:
                due_status_s = due_documents_s = 0.0
                self._put(partial(Knowledge.set_lost, why=str(error)))
            self._end.wait(max(begun_s + READING_INTERVAL_S - time.monotonic(), 0.05))

    # The age of a response counts from its request: the response may have been delayed.

    def _ask_reading(self) -> None:
        asked_s = time.monotonic()
        reading, _ = self._daemon.reading()
        self._put(lambda knowledge: knowledge.set_reading(reading, asked_s))

    def _ask_status(self) -> None:
        asked_s = time.monotonic()
        status, _ = self._daemon.status()
        self._put(lambda knowledge: knowledge.set_status(status, asked_s))

    def _ask_documents(self) -> None:
        check, _ = self._daemon.self_check()
        targets, _ = self._daemon.targets()
        self._put(lambda knowledge: knowledge.set_documents(check, targets))

    def _put(self, update: Update) -> None:
        with contextlib.suppress(queue.Full):
            self._updates.put_nowait(update)
