import logging
import socket
from pathlib import Path

import pytest
from support.clock import FakeClock
from support.measurements import measurement

from altd.instruments.beam.instrument import QUANTITIES
from altd.reasons import Reason
from altd.runtime.service_manager import ServiceManager, notify, state_folder
from altd.status.board import Board


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> socket.socket:
    """The service manager's end of the socket."""
    link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    link.bind(str(tmp_path / "notify"))
    link.setblocking(False)
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    return link


def words(link: socket.socket) -> list[str]:
    out = []
    while True:
        try:
            out.append(link.recv(4096).decode())
        except BlockingIOError:
            return out


def managed(now_ns: int, stale_after_s: float = 1.0) -> tuple[FakeClock, Board, ServiceManager]:
    clock = FakeClock(now_ns)
    board = Board(clock, stale_after_s, QUANTITIES)
    return clock, board, ServiceManager(board, clock, "unit A", ["http"])


async def test_ready_comes_with_the_first_word_and_life_signs_with_progress_only(told: socket.socket) -> None:
    clock, board, manager = managed(10**9)
    board.publish(measurement(1, 0, Reason.WARMING_UP))
    manager.progress()
    assert words(told) == ["READY=1\nSTATUS=not measuring: warming_up\nWATCHDOG=1"]
    for number in range(2, 22):
        await clock.advance(0.05)
        board.publish(measurement(number))
        manager.progress()
    assert words(told) == ["STATUS=measuring\nWATCHDOG=1"] * 5
    await clock.advance(60)
    assert words(told) == []
    told.close()


async def test_ready_follows_a_reload(told: socket.socket) -> None:
    clock, board, manager = managed(3 * 10**9, 9.0)
    board.publish(measurement(1))
    manager.progress()
    with manager.reloading():
        await clock.advance(0.25)
        manager.progress()
    for _ in range(2):
        await clock.advance(0.25)
        manager.progress()
    said = [word.split("\n") for word in words(told)]
    assert said[1] == ["RELOADING=1", "MONOTONIC_USEC=3000000"]
    assert [word[0] == "READY=1" for word in said] == [True, False, False, True, False]
    told.close()


def test_text_from_outside_adds_no_assignment(told: socket.socket) -> None:
    """Each line is one (sd_notify(3)); a camera names itself in the detail of a reason."""
    assert notify("STATUS=not measuring: wrong_camera (A\nSTOPPING=1)", "WATCHDOG=1")
    assert words(told) == ["STATUS=not measuring: wrong_camera (A\\nSTOPPING=1)\nWATCHDOG=1"]
    told.close()


async def test_a_manager_that_does_not_read_or_is_gone_holds_nothing(told: socket.socket) -> None:
    clock, board, manager = managed(10**9)
    board.publish(measurement(1))
    for _ in range(200):  # far more than a socket's queue holds
        manager.progress()
        await clock.advance(0.25)
    assert len(words(told)) < 200
    told.close()
    manager.progress()


async def test_ready_is_repeated_until_it_was_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "later"))
    clock, board, manager = managed(10**9, 10.0)
    manager.progress()  # nothing on the board yet
    board.publish(measurement(1))
    await clock.advance(0.25)
    manager.progress()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(str(tmp_path / "later"))
        link.setblocking(False)
        for _ in range(3):
            await clock.advance(0.25)
            manager.progress()
        first_lines = [word.split("\n")[0] for word in words(link)]
        assert first_lines == ["READY=1", "STATUS=measuring", "STATUS=measuring"]


async def test_the_journal_gets_a_line_when_something_changes_not_more_than_one_a_second(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock, board, manager = managed(10**9)
    with caplog.at_level(logging.INFO, "altd"):
        for number in range(200):
            board.publish(measurement(number, clock.now_ns, *([Reason.UNSTEADY] if number % 10 < 5 else [])))
            manager.progress()
            await clock.advance(0.25)
    assert caplog.messages[0] == "unit A: http"
    assert len(caplog.messages) <= 52
    assert {"measuring", "not measuring: unsteady"} == set(caplog.messages[1:])


@pytest.mark.parametrize(
    ("told", "folder"),
    [
        ("/var/lib/altd", Path("/var/lib/altd")),
        ("/var/lib/altd:/var/lib/more", Path("/var/lib/altd")),
        ("", None),
    ],
)
def test_the_state_folder_is_the_first_that_the_manager_names(
    told: str, folder: Path | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", told)
    assert state_folder() == folder
    monkeypatch.delenv("STATE_DIRECTORY")
    assert state_folder() is None
