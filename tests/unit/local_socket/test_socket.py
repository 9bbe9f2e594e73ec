"""Both ends of the local socket: a command asks whatever answers; the daemon replaces, refuses, leaves."""

import contextlib
import errno
import os
import socket
import stat
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.no_daemon import GARBAGE, http

from altd.local_socket import MODE, NoAnswerError, ask, listening


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
    with pytest.raises(NoAnswerError, match=f"the daemon is not running .*: nothing listens at {tmp_path}/s"):
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
        with pytest.raises(NoAnswerError, match=r"permission denied: it is for user \S+ and group \S+; join"):
            ask(tmp_path / "s", "/", 1.0)

    @pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a file away")
    def test_a_group_without_a_name_is_its_number(self, tmp_path: Path) -> None:
        (tmp_path / "s").touch()
        os.chown(tmp_path / "s", 54321, 54322)
        with pytest.raises(NoAnswerError, match="for user 54321 and group 54322"):
            ask(tmp_path / "s", "/", 1.0)


def left_by_the_dead(path: Path) -> None:
    """A socket's file at which no process listens any more."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(path))
        dead.listen()


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077])
def test_owner_and_group_may_connect_whatever_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        with listening(tmp_path / "s"):
            about = (tmp_path / "s").lstat()
    finally:
        os.umask(before)
    assert stat.S_ISSOCK(about.st_mode)
    assert stat.S_IMODE(about.st_mode) == MODE == 0o660


def test_its_file_is_removed_at_the_end_also_after_a_failure(tmp_path: Path) -> None:
    with contextlib.suppress(RuntimeError), listening(tmp_path / "s"):
        assert (tmp_path / "s").exists()
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_a_socket_of_a_dead_daemon_is_replaced(tmp_path: Path) -> None:
    left_by_the_dead(tmp_path / "s")
    assert (tmp_path / "s").exists()
    with listening(tmp_path / "s"), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.connect(str(tmp_path / "s"))


def test_that_of_a_live_one_is_an_error_that_names_it_and_stays(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with listening(path):
        taken = f"{path}: another process listens there"
        with pytest.raises(OSError, match=taken) as caught, listening(path):
            pytest.fail("served twice")
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
            client.connect(str(path))
    assert caught.value.errno == errno.EADDRINUSE


def test_a_live_one_whose_queue_is_full_is_alive(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as busy:
        busy.bind(str(path))
        busy.listen(0)
        waiting = [socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) for _ in range(4)]
        for client in waiting:
            client.setblocking(False)
            client.connect_ex(str(path))
        with pytest.raises(OSError, match="another process listens there"), listening(path):
            pytest.fail("served twice")
        for client in waiting:
            client.close()
        assert path.exists()


@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_what_is_no_socket_is_never_removed(tmp_path: Path, kind: str) -> None:
    path, other = tmp_path / "s", tmp_path / "other"
    if kind == "file":
        path.write_text("mine")
    elif kind == "folder":
        path.mkdir()
    else:
        left_by_the_dead(other)
        path.symlink_to(other)
    with pytest.raises(OSError, match=f"{path}: the file is not a socket") as caught, listening(path):
        pytest.fail("served")
    assert caught.value.errno == errno.EADDRINUSE
    assert os.path.lexists(path)


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / "none" / "s"
    with pytest.raises(OSError, match=f"{path}: No such file") as caught, listening(path):
        pytest.fail("served")
    assert caught.value.errno == errno.ENOENT


def test_the_file_of_another_that_took_its_place_stays(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with listening(path):
        path.unlink()
        left_by_the_dead(path)
    assert path.exists()
