"""A self-check asked of the running daemon: through its local socket, or over HTTP on its own computer."""

from __future__ import annotations

import http.client
import os
from pathlib import Path
from typing import Any

from altd.app.local import socket_to_ask
from altd.config import Config
from altd.errors import BadInputError
from altd.files.documents import parse_json
from altd.local_socket.asking import MAX_ANSWER_BYTES, NoAnswerError, ask
from altd.publish.http.guard import REQUEST_HEADER
from altd.publish.http.self_check import WAIT_S

_ANYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104  where the daemon listens on every address
_TARGET = "/api/self-check"
_HEADERS = {REQUEST_HEADER: "selfcheck"}
_TIMEOUT_S = WAIT_S + 5.0


def ask_running_daemon(config: Config, place: Path) -> dict[str, Any]:
    """The document of a check that the daemon with this config makes now, as ``/api/self-check`` gives it.

    Through the local socket where there is one. Over HTTP where there is none, as of a daemon that was
    started by hand, or where this user may not open it. Raises BadInputError for a config by which neither
    is there, NoAnswerError where no check can be had.
    """
    status, document = _answer(config, place)
    if status == http.client.OK and isinstance(document, dict) and "verdict" in document:
        return document
    said = document.get("error") if isinstance(document, dict) else None
    raise NoAnswerError(said if isinstance(said, str) else f"the answer is {status}, and no verdict")


def _answer(config: Config, place: Path) -> tuple[int, Any]:
    path, said = socket_to_ask(config), ""
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
        raise NoAnswerError(f"what answers at {host} port {port} is no daemon of altd: {error}") from error
    finally:
        connection.close()
