from __future__ import annotations

import os
import pwd
import socket
import threading
import time
from pathlib import Path

import pytest

from altd.errors import BadInputError
from altd.files.reading import read_file, read_head


def complaint(path: Path, largest_bytes: int = 1000) -> str:
    with pytest.raises(BadInputError) as caught:
        read_file(path, largest_bytes)
    assert "\n" not in str(caught.value)
    return caught.value.message


def test_a_file_is_read_up_to_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * 1000)
    assert read_file(path, 1000) == b"x" * 1000
    assert read_head(path, 3) == b"xxx"
    assert complaint(path, 999) == "is 1000 bytes long, more than 999"


def test_a_missing_permission_names_user_owner_mode_and_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = tmp_path / "closed"
    (closed / "folder").mkdir(parents=True, mode=0o700)
    path = closed / "folder" / "file"
    path.touch(0o600)
    user = pwd.getpwuid(os.geteuid()).pw_name

    def refuse(*_arguments: object, **_names: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    remedy = "; use sudo, or chmod and chgrp"
    said = f"Permission denied: this is user {user}, "
    assert complaint(path) == f"{said}the file belongs to {user}, mode 0600{remedy}"
    with monkeypatch.context() as inner:
        stat = os.stat
        inner.setattr(os, "stat", lambda place, **names: refuse() if place == path else stat(place, **names))
        assert complaint(path) == f"{said}the folder {path.parent} belongs to {user}, mode 0700{remedy}"


def test_a_file_of_a_terabyte_is_refused_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    assert complaint(path) == f"is {1 << 40} bytes long, more than 1000"
    assert read_head(path, 2) == b"\0\0"


def test_a_pipe_a_device_a_socket_and_a_folder_are_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
        assert complaint(tmp_path / "socket") == "is a socket, not a file"
    assert complaint(tmp_path / "pipe") == "is a pipe, not a file"  # without a writer: it does not wait
    assert complaint(tmp_path) == "is a folder, not a file"
    assert complaint(Path("/dev/zero")) == "is a device, not a file"
    (tmp_path / "link").symlink_to("/dev/zero")
    assert complaint(tmp_path / "link") == "is a device, not a file"


def test_a_path_that_leads_nowhere_is_named(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    assert complaint(tmp_path / "loop") == "Too many levels of symbolic links"
    assert complaint(tmp_path / "none") == "No such file or directory"
    assert complaint(tmp_path / ("x" * 300)) == "File name too long"
    assert complaint(Path("a\0b")) == "is not a path"
    assert complaint(Path("\ud800")) == "is not a path"


def test_a_file_of_proc_has_no_size_and_is_bounded_all_the_same() -> None:
    assert len(read_file(Path("/proc/self/stat"), 10_000)) > 50
    assert complaint(Path("/proc/self/stat"), 20) == "is more than 20 bytes long"


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path: Path) -> None:
    path, done = tmp_path / "file", threading.Event()
    path.write_bytes(b"x" * (4 << 20))

    def grow() -> None:
        with path.open("ab", buffering=0) as file:
            while not done.is_set():
                file.write(b"y")

    growing = threading.Thread(target=grow)
    growing.start()
    try:
        complaints = set[str]()
        deadline_s = time.monotonic() + 20
        while not complaints and time.monotonic() < deadline_s:  # it may get no turn for a while
            try:
                read_file(path, 1 << 30)
            except BadInputError as error:
                complaints.add(error.message)
        assert complaints == {"was changed while it was read"}
    finally:
        done.set()
        growing.join()
