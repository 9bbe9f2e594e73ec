"""The folder of a demo: what it names, what it leaves, and what it says where it cannot be had."""

import asyncio
import contextlib
import os
import socket
from pathlib import Path

import pytest

from altd.errors import BadInputError
from hw_sim.__main__ import command_parser
from hw_sim.demo import run
from hw_sim.demo_folder import demo_folder
from hw_sim.demo_lines import Line


def test_a_temporary_one_goes_with_all_that_is_in_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with demo_folder(None) as folder:
        assert os.access(folder.path / "altd", os.X_OK)
        (folder.path / "history.db").touch()
    assert list(tmp_path.iterdir()) == []


def test_one_that_is_kept_loses_only_the_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with demo_folder(Path("a", "b c")) as folder:
        assert folder.path == tmp_path / "a" / "b c"
        (_, watch), (_, events) = folder.commands()
        assert watch == f"cd '{folder.path}' && ./altd watch --socket altd.sock"
        assert events == f"cd '{folder.path}' && ./altd events --history history.db"
        (folder.path / "history.db").touch()
    assert [path.name for path in (tmp_path / "a" / "b c").iterdir()] == ["history.db"]


def test_the_link_of_a_demo_that_was_killed_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "altd").symlink_to("/nowhere")
    with demo_folder(tmp_path) as folder:
        assert (folder.path / "altd").exists()


def test_a_file_of_somebody_stays_and_is_named(tmp_path: Path) -> None:
    (tmp_path / "altd").write_text("mine")
    with pytest.raises(BadInputError, match=r"altd: File exists"), demo_folder(tmp_path):
        pass
    assert (tmp_path / "altd").read_text() == "mine"


@pytest.mark.parametrize("option", ["--http-port", "--modbus-port"])
def test_a_taken_port_is_named_at_once(option: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        arguments = command_parser().parse_args(["demo", option, str(port)])
        with pytest.raises(BadInputError, match=f"port {port}: Address already in use by "):
            run(arguments)


def test_a_path_that_is_too_long_for_a_socket_costs_only_the_socket(tmp_path: Path) -> None:
    with demo_folder(tmp_path / ("x" * 100)) as folder:
        assert folder.local is None
        assert "no altd watch" in folder.commands()[0][1]
        assert folder.history.file == folder.path / "history.db"


def test_the_socket_is_as_long_as_unix_allows(tmp_path: Path) -> None:
    """107 bytes and the one that ends it (unix(7))."""
    room = 107 - len("/altd.sock") - len(os.fsencode(tmp_path)) - 1
    for length, has_socket in ((room, True), (room + 1, False)):
        with demo_folder(tmp_path / ("x" * length)) as folder:
            assert (folder.local is not None) is has_socket


def test_what_is_no_folder_is_named_and_left_as_it_was(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(BadInputError, match=f"^{file}: is not a folder$"), demo_folder(file):
        pass
    assert file.read_text() == "mine"


async def heard(descriptor: int, length: int) -> bytes:
    data = b""
    while len(data) < length:
        with contextlib.suppress(BlockingIOError):
            data += os.read(descriptor, 100)
        await asyncio.sleep(0.002)
    return data


async def test_a_line_carries_both_ways_and_keeps_nothing_for_who_comes_late() -> None:
    with Line() as line:
        forwarding = asyncio.create_task(line.forward())
        unit = os.open(line.unit_end, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            for round_ in (b"1", b"2"):
                os.write(unit, b"nobody hears " + round_)
                await asyncio.sleep(0.1)
                far = os.open(line.far_end, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                await asyncio.sleep(0.1)
                os.write(unit, b"out " + round_)
                os.write(far, b"in " + round_)
                assert await heard(far, 5) == b"out " + round_
                assert await heard(unit, 4) == b"in " + round_
                os.write(unit, b"not read " + round_)
                await asyncio.sleep(0.1)
                os.close(far)
                await asyncio.sleep(0.1)
        finally:
            os.close(unit)
            forwarding.cancel()
            with pytest.raises(asyncio.CancelledError):
                await forwarding
