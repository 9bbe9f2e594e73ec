"""`altd selfcheck` with any program that answers at the daemon's port."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from support.cli import altd_here, refusal
from support.no_daemon import GARBAGE, http
from support.unit_toml import played_toml


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
                connection.sendall(http(b'{"verdict": "good"}'))

        thread = threading.Thread(target=serve)
        thread.start()
        said = altd_here("selfcheck", "--config", path, "--json")
        thread.join()
    assert (said.status, said.objects) == (0, [{"verdict": "good"}])


def test_where_neither_answers_both_are_told(tmp_path: Path) -> None:
    path = tmp_path / "altd.toml"
    path.write_text(played_toml("cal.json", "rec", f'[http]\nport = 9\n[local]\nsocket = "{tmp_path}/s"\n'))
    said = altd_here("selfcheck", "--config", path)
    assert (said.status, said.out) == (1, "")
    (line,) = said.err.splitlines()
    assert line.startswith(f"altd selfcheck: there is no socket {tmp_path}/s: the daemon does not run, ")
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
    with answered(tmp_path, http(json.dumps({"verdict": verdict, "number": 3}).encode())) as config:
        said = altd_here("selfcheck", "--config", config, "--json")
    assert (said.status, said.err) == (status, "")
    assert said.objects == [{"verdict": verdict, "number": 3}]
