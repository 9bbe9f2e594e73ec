"""The daemon's end of the local socket: what it replaces, what it refuses, what it leaves."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import stat
from pathlib import Path

import pytest

from altd.local_socket import MODE, listening


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
        with (
            pytest.raises(OSError, match=f"{path}: another process listens there") as caught,
            listening(path),
        ):
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
    with (
        pytest.raises(OSError, match=f"{path}: the file is not a socket") as caught,
        listening(path),
    ):
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
