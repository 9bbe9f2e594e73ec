"""`altd status` and `altd selfcheck` with any program that answers, a good daemon or a faulty one."""

import contextlib
import json
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from support.cli import altd_here, refusal
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
from support.no_daemon import GARBAGE, http
from support.unit_toml import played_toml

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


@contextmanager
def answered(tmp_path: Path, answer: bytes) -> Iterator[Path]:
    """Settings of a daemon at whose port one request is answered so, whatever it is."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection, suppress(OSError):  # the client may leave early
                connection.recv(65536)
                connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        path = tmp_path / "altd.toml"
        http = f'[http]\nhost = "127.0.0.1"\nport = {server.getsockname()[1]}\n'
        path.write_text(played_toml("cal.json", "rec", http))
        yield path
        thread.join()


@pytest.mark.parametrize(
    ("answer", "complaint"),
    [
        (b"", "no daemon answers at 127.0.0.1 port "),
        *GARBAGE,
        (http(b"[]"), "the answer is 200, not a verdict"),
        (http(b'{"error": {"a": 1}}', b"HTTP/1.1 500 Oh"), "the answer is 500, not a verdict"),
        (http(b'{"verdict": "good"}', b"HTTP/1.1 302 Elsewhere"), "the answer is 302, not a verdict"),
        (http(b'{"verdict": [3]}'), "the answer is not a self-check: verdict: "),
        (http(b'{"error": "no frame LEDs"}', b"HTTP/1.1 409 No"), "no frame LEDs"),
        (http(b'{"error": "a\\n\\u001b[2Jb"}', b"HTTP/1.1 409 No"), r"a\n\x1b[2Jb"),
    ],
)
def test_what_is_no_check_is_one_line_and_status_1(tmp_path: Path, answer: bytes, complaint: str) -> None:
    with answered(tmp_path, answer) as config:
        said = altd_here("selfcheck", "--config", config)
    assert (said.status, said.out) == (1, "")
    (line,) = said.err.splitlines()
    assert line.startswith("altd selfcheck: ")
    assert complaint in line


def test_the_local_socket_is_asked_first(tmp_path: Path) -> None:
    """HTTP has no daemon; its sentence is that of a daemon which answers on the socket."""
    path = tmp_path / "altd.toml"
    tables = f'[http]\nport = 9\n[local]\nsocket = "{tmp_path}/s"\n'
    path.write_text(played_toml("cal.json", "rec", tables))
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as server:
        server.bind(str(tmp_path / "s"))
        server.listen()

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                assert connection.recv(65536).startswith(b"POST /api/self-check HTTP/1.1\r\n")
                connection.sendall(http(b'{"verdict": "good", "reasons": []}'))

        thread = threading.Thread(target=serve)
        thread.start()
        said = altd_here("selfcheck", "--config", path, "--json")
        thread.join()
    assert (said.status, said.objects) == (0, [{"verdict": "good", "reasons": []}])


def test_where_neither_answers_both_are_told(tmp_path: Path) -> None:
    path = tmp_path / "altd.toml"
    path.write_text(played_toml("cal.json", "rec", f'[http]\nport = 9\n[local]\nsocket = "{tmp_path}/s"\n'))
    said = altd_here("selfcheck", "--config", path)
    assert (said.status, said.out) == (1, "")
    (line,) = said.err.splitlines()
    assert line.startswith(f"altd selfcheck: there is no socket {tmp_path}/s: the daemon is not running ")
    assert "no daemon answers at 127.0.0.1 port 9: " in line


def test_a_daemon_that_nobody_can_ask_is_a_fault_of_the_config(tmp_path: Path) -> None:
    path = tmp_path / "altd.toml"
    path.write_text(played_toml("cal.json", "rec"))
    line = refusal(altd_here("selfcheck", "--config", path))
    assert line == (
        f"altd selfcheck: {path}: no [local] and no [http] table, and no socket "
        "/run/altd/altd.sock: nowhere to ask"
    )


@pytest.mark.parametrize(("verdict", "status"), [("good", 0), ("suspect", 1), ("unknown", 1)])
def test_a_verdict_is_written_as_it_came(tmp_path: Path, verdict: str, status: int) -> None:
    with answered(
        tmp_path, http(json.dumps({"verdict": verdict, "reasons": [], "number": 3}).encode())
    ) as config:
        said = altd_here("selfcheck", "--config", config, "--json")
    assert (said.status, said.err) == (status, "")
    assert said.objects == [{"verdict": verdict, "reasons": [], "number": 3}]
