"""`altd status` with any program that answers at a socket: a good daemon, a faulty one, another one."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from support.cli import altd_here
from support.daemon_documents import (
    CALIBRATION,
    CHECK,
    DUSTY,
    SPOT_MISSING,
    TARGETS,
    invalid,
    measurement,
    status,
)

GOOD: Mapping[str, Any] = {
    "/api/v1/measurement": measurement(),
    "/api/v1/status": status(),
    "/api/v1/self-check": CHECK,
    "/api/v1/targets": TARGETS,
    "/api/v1/calibration": CALIBRATION,
}


@contextlib.contextmanager
def answering(path: Path, answers: Mapping[str, Any], code: str = "200 OK") -> Iterator[Path]:
    """A server that answers each path with its document."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as server:
        server.bind(str(path))
        server.listen()
        server.settimeout(0.1)
        end = threading.Event()

        def work() -> None:
            while not end.is_set():
                with contextlib.suppress(OSError):
                    connection, _ = server.accept()
                    with connection:
                        target = connection.recv(65536).split()[1].decode()
                        body = json.dumps(answers[target]).encode()
                        head = f"HTTP/1.1 {code}\r\nContent-Length: {len(body)}\r\n\r\n"
                        connection.sendall(head.encode() + body)

        thread = threading.Thread(target=work)
        thread.start()
        try:
            yield path
        finally:
            end.set()
            thread.join()


@pytest.mark.parametrize(
    ("changes", "exit_status", "state"),
    [
        ({}, 0, "good"),
        ({"/api/v1/status": status(DUSTY, signal="maintenance_required")}, 0, "MAINTENANCE REQUIRED"),
        ({"/api/v1/status": status(SPOT_MISSING, signal="out_of_specification")}, 1, "OUT OF SPECIFICATION"),
        ({"/api/v1/measurement": invalid("stale")}, 1, "good"),
        ({"/api/v1/measurement": {"error": "nothing yet", "status": ["warming_up"]}}, 1, "good"),
    ],
)
def test_the_exit_status_says_whether_it_may_be_used(
    tmp_path: Path, changes: dict[str, Any], exit_status: int, state: str
) -> None:
    with answering(tmp_path / "s", {**GOOD, **changes}) as path:
        said = altd_here("status", "--socket", path)
        as_json = altd_here("status", "--socket", path, "--json")
    assert (said.status, as_json.status, said.err) == (exit_status, exit_status, "")
    assert f"state        {state} for 2 h 3 min" in said.out
    (document,) = as_json.objects
    assert document == {
        "measurement": {**GOOD, **changes}["/api/v1/measurement"],
        "status": {**GOOD, **changes}["/api/v1/status"],
        "self_check": CHECK,
        "calibration": CALIBRATION,
    }


@pytest.mark.parametrize("target", ["/api/v1/measurement", "/api/v1/status", "/api/v1/self-check"])
@pytest.mark.parametrize("document", [[], {}, {"a": "\x1b[2J"}, None, 7, "x", {"error": "\x1b[2J"}])
def test_a_document_that_is_none_is_one_line(tmp_path: Path, target: str, document: object) -> None:
    with answering(tmp_path / "s", {**GOOD, target: document}) as path:
        said = altd_here("status", "--socket", path)
    assert (said.status, said.out) == (1, "")
    (line,) = said.err.splitlines()
    assert line.startswith(f"altd status: the server at {path} gives no usable {target}: ")
    assert line.isprintable()


@pytest.mark.parametrize("code", ["404 Not Found", "429 Too Many Requests", "302 Elsewhere", "204 No"])
def test_another_answer_than_a_good_one_is_said(tmp_path: Path, code: str) -> None:
    with answering(tmp_path / "s", GOOD, code) as path:
        said = altd_here("status", "--socket", path)
    assert said.status == 1
    assert "/api/v1/measurement: it answers " in said.err or "is not an altd daemon" in said.err
