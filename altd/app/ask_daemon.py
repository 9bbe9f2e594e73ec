"""A running daemon asked through its local socket: once, again and again, or for a self-check."""

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
from altd.config.table import NAME_PATTERN
from altd.errors import BadInputError
from altd.files.documents import parse_json
from altd.instruments.beam.instrument import QUANTITIES as OF_BEAM
from altd.instruments.chain.measurement import quantities_of
from altd.instruments.planar.instrument import QUANTITIES as OF_PLATE
from altd.local_socket import MAX_ANSWER_BYTES, NoAnswerError, ask
from altd.publish.http.clients import SELF_CHECK_WAIT_S
from altd.publish.http.guard import REQUEST_HEADER
from altd.records import Quantities
from altd.terminal.documents import (
    CalibrationDocument,
    Reading,
    SelfCheckDocument,
    StatusDocument,
    TargetsDocument,
    reading_of,
)
from altd.terminal.knowledge import Knowledge

Document = TypeVar("Document")

_MAX_TARGETS = 16
_NAME = re.compile(NAME_PATTERN)
_QUANTITIES = replace(OF_BEAM, of_unit=OF_BEAM.of_unit + OF_PLATE.of_unit)
"""Of any instrument: a measurement has those of its own."""

_GOOD = (http.client.OK, http.client.SERVICE_UNAVAILABLE)
"""503 is how a measurement is answered while there is none; any other answer with 503 has other keys."""


@dataclass(frozen=True, slots=True)
class RunningDaemon:
    """The daemon at a socket; each question raises NoAnswerError, and ends within ``timeout_s``."""

    path: Path
    timeout_s: float

    def reading(self) -> tuple[Reading | None, object]:
        """The latest measurement and its document; None: nothing was measured so far."""
        return self._asked(
            "/api/v1/measurement", lambda document: reading_of(document, _quantities_of(document))
        )

    def status(self) -> tuple[StatusDocument, object]:
        """The unit's state, causes, availability and components."""
        return self._asked("/api/v1/status", StatusDocument.checked)

    def self_check(self) -> tuple[SelfCheckDocument, object]:
        """The last self-check."""
        return self._asked("/api/v1/self-check", SelfCheckDocument.checked)

    def calibration(self) -> tuple[CalibrationDocument, object]:
        """The quality of the targets' calibration."""
        return self._asked("/api/v1/calibration", CalibrationDocument.checked)

    def targets(self) -> tuple[TargetsDocument, object]:
        """The areas in which the targets are measured."""
        return self._asked("/api/v1/targets", TargetsDocument.checked)

    def _asked(self, target: str, understood: Callable[[object], Document]) -> tuple[Document, object]:
        status, document = ask(self.path, target, self.timeout_s)
        if status not in _GOOD:
            raise NoAnswerError(f"the server at {self.path} has no {target}: it answers {status}")
        try:
            return understood(document), document
        except ValueError as error:
            raise NoAnswerError(f"the server at {self.path} gives no usable {target}: {error}") from error


def _quantities_of(document: object) -> Quantities:
    """Quantities of a measurement: those of a row if the document names targets, else of any instrument."""
    targets = document.get("targets") if isinstance(document, dict) else None
    if not isinstance(targets, dict):
        return _QUANTITIES
    return quantities_of([name for name in list(targets)[:_MAX_TARGETS] if _NAME.fullmatch(name)])


_ANYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104  where the daemon listens on every address
_TARGET = "/api/self-check"
_HEADERS = {REQUEST_HEADER: "selfcheck"}
_TIMEOUT_S = SELF_CHECK_WAIT_S + 5.0


def ask_running_daemon(config: Config, place: Path) -> dict[str, Any]:
    """The document of a check that the daemon with this config makes now, as ``/api/self-check`` gives it.

    Through the local socket where there is one. Over HTTP where there is none, as of a daemon that was
    started by hand, or where this user may not open it. Raises BadInputError for a config by which neither
    is there, NoAnswerError where no check is possible.
    """
    status, document = _answer(config, place)
    if status == http.client.OK and isinstance(document, dict) and "verdict" in document:
        return document
    said = document.get("error") if isinstance(document, dict) else None
    raise NoAnswerError(said if isinstance(said, str) else f"the answer is {status}, and no verdict")


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
        raise NoAnswerError(f"the server at {host} port {port} is no daemon of altd: {error}") from error
    finally:
        connection.close()


READING_INTERVAL_S = 0.2
STATUS_INTERVAL_S = 0.5
SELDOM_INTERVAL_S = 5.0
_MAX_HEARD = 64
"""Answers that wait to be shown; further ones are dropped meanwhile."""

Telling = Callable[[Knowledge], None]


class Follower:
    """Asks while it is entered; ``tell`` hands on what was heard meanwhile."""

    def __init__(self, daemon: RunningDaemon) -> None:
        self._daemon = daemon
        self._heard: queue.Queue[Telling] = queue.Queue(_MAX_HEARD)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="follow the daemon", daemon=True)

    def __enter__(self) -> Follower:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join(timeout=2 * self._daemon.timeout_s)

    def tell(self, knowledge: Knowledge) -> None:
        """Hand over all that was heard since."""
        with contextlib.suppress(queue.Empty):
            while True:
                self._heard.get_nowait()(knowledge)

    def _follow(self) -> None:
        due_status_s = due_seldom_s = 0.0
        while not self._end.is_set():
            begun_s = time.monotonic()
            try:
                self._ask_reading()
                if begun_s >= due_seldom_s:
                    self._ask_seldom()
                    due_seldom_s = begun_s + SELDOM_INTERVAL_S
                if begun_s >= due_status_s:
                    self._ask_status()
                    due_status_s = begun_s + STATUS_INTERVAL_S
            except NoAnswerError as error:
                due_status_s = due_seldom_s = 0.0
                self._put(partial(Knowledge.hear_nothing, why=str(error)))
            self._end.wait(max(begun_s + READING_INTERVAL_S - time.monotonic(), 0.05))

    # An answer counts from when it was asked for: it may have waited on its way.

    def _ask_reading(self) -> None:
        asked_s = time.monotonic()
        reading, _ = self._daemon.reading()
        self._put(lambda knowledge: knowledge.hear_reading(reading, asked_s))

    def _ask_status(self) -> None:
        asked_s = time.monotonic()
        status, _ = self._daemon.status()
        self._put(lambda knowledge: knowledge.hear_status(status, asked_s))

    def _ask_seldom(self) -> None:
        check, _ = self._daemon.self_check()
        targets, _ = self._daemon.targets()
        self._put(lambda knowledge: knowledge.hear_about(check, targets))

    def _put(self, telling: Telling) -> None:
        with contextlib.suppress(queue.Full):
            self._heard.put_nowait(telling)
