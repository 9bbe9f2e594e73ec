"""A command's end of the local socket: whatever program answers, it ends in time and in one line."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.no_daemon import GARBAGE, http

from altd.local_socket import NoAnswerError, ask


@contextlib.contextmanager
def answered(path: Path, serve: Callable[[socket.socket], None]) -> Iterator[Path]:
    """A server at ``path`` that treats one client so."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as server:
        server.bind(str(path))
        server.listen()
        server.settimeout(60)

        def work() -> None:
            with contextlib.suppress(OSError):
                connection, _ = server.accept()
                with connection:
                    serve(connection)

        thread = threading.Thread(target=work)
        thread.start()
        yield path
        thread.join()


def saying(answer: bytes) -> Callable[[socket.socket], None]:
    def serve(connection: socket.socket) -> None:
        connection.recv(65536)
        connection.sendall(answer)

    return serve


def test_status_and_document_come_back(tmp_path: Path) -> None:
    with answered(tmp_path / "s", saying(http(b'{"a": 1}', b"HTTP/1.1 503 No"))) as path:
        assert ask(path, "/api/measurement", 5.0) == (503, {"a": 1})


def test_the_request_is_one_that_the_daemon_takes(tmp_path: Path) -> None:
    heard: list[bytes] = []

    def serve(connection: socket.socket) -> None:
        heard.append(connection.recv(65536))
        connection.sendall(http(b"{}"))

    with answered(tmp_path / "s", serve) as path:
        ask(path, "/api/self-check", 5.0, "POST", {"X-Altd-Request": "1"})
    first, *headers = heard[0].decode().split("\r\n")
    assert first == "POST /api/self-check HTTP/1.1"
    assert {"Host: localhost", "X-Altd-Request: 1", "Content-Length: 0"} <= set(headers)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (b"", "is not an altd daemon: Remote end closed connection without response"),
        *GARBAGE,
        (b"HTTP/1.1 \x1b[2J\n\r\n", r"\x1b[2J"),
    ],
)
def test_garbage_is_one_line(tmp_path: Path, answer: bytes, said: str) -> None:
    with answered(tmp_path / "s", saying(answer)) as path, pytest.raises(NoAnswerError) as caught:
        ask(path, "/", 5.0)
    line = str(caught.value)
    assert said in line
    assert line.isprintable()


def test_who_says_nothing_is_waited_for_so_long(tmp_path: Path) -> None:
    begun, given_up = time.monotonic(), threading.Event()
    with answered(tmp_path / "s", lambda connection: given_up.wait(60)) as path:
        with pytest.raises(NoAnswerError, match=r"does not answer within 0\.3 s"):
            ask(path, "/", 0.3)
        assert 0.3 <= time.monotonic() - begun < 30.0
        given_up.set()


def test_who_trickles_is_not_waited_for_longer(tmp_path: Path) -> None:
    """A byte before each time-out of a single read: the whole answer has one end."""
    answer, sent = http(b"{}" + b" " * 1000), 0

    def serve(connection: socket.socket) -> None:
        nonlocal sent
        with contextlib.suppress(OSError):
            for byte in answer:
                connection.sendall(bytes([byte]))
                sent += 1
                time.sleep(0.05)

    with answered(tmp_path / "s", serve) as path:
        with pytest.raises(NoAnswerError, match=r"does not answer within 0\.4 s"):
            ask(path, "/", 0.4)
        assert 0 < sent < len(answer) / 4


def test_a_full_queue_is_a_daemon_that_does_not_answer(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as busy, contextlib.ExitStack() as clients:
        busy.bind(str(path))
        busy.listen(0)
        for _ in range(4):
            client = clients.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            client.setblocking(False)
            client.connect_ex(str(path))
        with pytest.raises(NoAnswerError, match="does not answer within"):
            ask(path, "/", 0.2)


def test_no_daemon_is_said_so(tmp_path: Path) -> None:
    with pytest.raises(NoAnswerError, match=f"there is no socket {tmp_path}/s"):
        ask(tmp_path / "s", "/", 1.0)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(tmp_path / "s"))
    with pytest.raises(NoAnswerError, match=f"the daemon does not run: nothing listens at {tmp_path}/s"):
        ask(tmp_path / "s", "/", 1.0)
    with pytest.raises(NoAnswerError, match="no daemon answers at"):
        ask(tmp_path / ("x" * 200), "/", 1.0)


class TestWhoMay:
    """root may open anything: what the kernel refuses others is played here, its words are not."""

    @pytest.fixture(autouse=True)
    def _refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(self: socket.socket, address: str) -> None:
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(socket.socket, "connect", refuse)

    def test_the_group_is_named(self, tmp_path: Path) -> None:
        (tmp_path / "s").touch()
        if os.geteuid() == 0:
            os.chown(tmp_path / "s", 0, 20)
        with pytest.raises(
            NoAnswerError, match=r"permission denied: it is for user \S+ and group \S+; join the"
        ):
            ask(tmp_path / "s", "/", 1.0)

    @pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a file away")
    def test_a_group_without_a_name_is_its_number(self, tmp_path: Path) -> None:
        (tmp_path / "s").touch()
        os.chown(tmp_path / "s", 54321, 54322)
        with pytest.raises(NoAnswerError, match="for user 54321 and group 54322"):
            ask(tmp_path / "s", "/", 1.0)
