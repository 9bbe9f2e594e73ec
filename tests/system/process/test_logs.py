"""The log: nobody waits for it, nobody floods it. The daemon is a process, its standard error a real pipe."""

from __future__ import annotations

import contextlib
import logging
import os
import resource
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.played_unit import PlayedUnit, playing

from altd.process.logs import LOG_REPEAT_S, MAX_CAUSES, MAX_WAITING_LINES, RepeatLimit, logging_to_stderr

log = logging.getLogger("altd")


@pytest.fixture
def full_pipe() -> Iterator[int]:
    """The end to write to of a pipe that nobody reads and that takes nothing more."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    while True:
        try:
            os.write(writer, bytes(4096))
        except BlockingIOError:
            break
    os.set_blocking(writer, True)
    yield writer
    os.close(reader)
    os.close(writer)


@contextlib.contextmanager
def own_stderr() -> Iterator[int]:
    """A pipe in place of descriptor 2; gives the end to read from."""
    reader, writer = os.pipe()
    kept = os.dup(2)
    os.dup2(writer, 2)
    os.close(writer)
    try:
        yield reader
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(reader)


def test_a_full_pipe_holds_neither_measuring_nor_the_end(
    played_unit: PlayedUnit, full_pipe: int, tmp_path: Path
) -> None:
    with playing(played_unit, tmp_path, full_pipe) as daemon:
        daemon.wait_until_valid()
        first = daemon.measurement()["sequence"]
        time.sleep(0.5)
        assert daemon.measurement()["sequence"] > first
        daemon.process.send_signal(signal.SIGTERM)
        assert daemon.process.wait(10) == 0


def test_a_full_pipe_does_not_hold_a_refusal(full_pipe: int, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "altd.cli", "run", "--config", str(tmp_path / "none.toml")],
        stderr=full_pipe,
        timeout=20,
        check=False,
    )
    assert done.returncode == 2


def test_descriptors_that_run_out_are_a_line_and_cost_no_measurement(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    def few_descriptors() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (32, 32))

    with playing(played_unit, tmp_path, subprocess.PIPE, few_descriptors) as daemon:
        daemon.wait_until_valid()
        flood = [socket.create_connection(("127.0.0.1", daemon.http)) for _ in range(60)]
        heartbeats = set()
        with socket.create_connection(("127.0.0.1", daemon.modbus), timeout=5) as controller:
            for _ in range(20):
                controller.sendall(bytes.fromhex("0001 0000 0006 01 04 0000 0006"))
                answer = controller.recv(64)
                status, *_, heartbeat = struct.unpack(">6H", answer[9:])
                assert status & 1
                heartbeats.add(heartbeat)
                time.sleep(0.1)
        for connection in flood:
            connection.close()
        assert len(heartbeats) > 5
        daemon.wait_until_valid()
        daemon.process.send_signal(signal.SIGTERM)
        _, said = daemon.process.communicate(timeout=10)
        assert daemon.process.returncode == 0
    assert b"Traceback" not in said
    assert len(said.splitlines()) <= 8, said.decode()


@pytest.mark.parametrize("closed", [(2,), (0, 1, 2)])
def test_a_daemon_needs_no_standard_stream(
    played_unit: PlayedUnit, tmp_path: Path, closed: tuple[int, ...]
) -> None:
    def close() -> None:
        for descriptor in closed:
            os.close(descriptor)

    with playing(played_unit, tmp_path, subprocess.DEVNULL, close) as daemon:
        daemon.wait_until_valid()
        daemon.process.send_signal(signal.SIGTERM)
        assert daemon.process.wait(10) == 0


def test_a_terminal_that_goes_away_ends_the_daemon_in_order(played_unit: PlayedUnit, tmp_path: Path) -> None:
    def heed() -> None:  # whoever runs the tests may ignore it
        signal.signal(signal.SIGHUP, signal.SIG_DFL)

    with playing(played_unit, tmp_path, subprocess.DEVNULL, heed) as daemon:
        daemon.wait_until_valid()
        daemon.process.send_signal(signal.SIGHUP)
        assert daemon.process.wait(10) == 0


def test_a_daemon_that_ignores_the_terminal_goes_on(played_unit: PlayedUnit, tmp_path: Path) -> None:
    """As nohup(1) starts it."""

    def ignore() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    with playing(played_unit, tmp_path, subprocess.DEVNULL, ignore) as daemon:
        daemon.wait_until_valid()
        daemon.process.send_signal(signal.SIGHUP)
        time.sleep(0.3)
        assert daemon.measurement()["valid"]


def test_what_the_pipe_does_not_take_is_dropped_and_counted() -> None:
    with own_stderr() as reader, logging_to_stderr(logging.INFO):
        for number in range(3 * MAX_WAITING_LINES):
            log.info("line %d %s", number, "x" * 100)
        said = b""
        while b"were dropped" not in said:
            said += os.read(reader, 65536)
    lines = said.decode().splitlines()
    (counted,) = [line for line in lines if "were dropped" in line]
    assert len(lines) - 1 + int(counted.split(": ")[-1].split()[0]) == 3 * MAX_WAITING_LINES


def test_what_was_held_back_is_counted_at_the_end() -> None:
    with own_stderr() as reader:
        with logging_to_stderr(logging.INFO):
            for number in range(1000):
                log.warning("camera front: broke %d times", number)
        said = os.read(reader, 65536)
    assert said.decode().splitlines() == [
        "altd: camera front: broke 0 times",
        f"altd: camera front: broke 0 times (999 more like it in {LOG_REPEAT_S:g} s)",
    ]


class TestRepeatLimit:
    @pytest.fixture
    def limit(self) -> RepeatLimit:
        self.now_s = 100.0
        return RepeatLimit(lambda: self.now_s)

    def note(
        self, limit: RepeatLimit, text: str, name: str = "altd", level: int = logging.WARNING
    ) -> str | None:
        return limit.note(logging.LogRecord(name, level, "", 0, text, None, None))

    def test_a_cause_is_said_once_and_then_with_its_count(self, limit: RepeatLimit) -> None:
        assert self.note(limit, "port 0x7f12 of 80") == ""
        assert self.note(limit, "port 0x7f13 of 81") is None
        assert self.note(limit, "port 0x7f14 of 82") is None
        self.now_s += LOG_REPEAT_S
        assert self.note(limit, "port 0x7f15 of 83") == f" (2 more like it in {LOG_REPEAT_S:g} s)"
        assert self.note(limit, "port 0x7f15 of 83") is None

    def test_causes_do_not_hold_each_other_back(self, limit: RepeatLimit) -> None:
        assert self.note(limit, "a") == self.note(limit, "b") == ""
        assert self.note(limit, "a", name="asyncio") == ""
        assert self.note(limit, "a", level=logging.ERROR) == ""

    def test_ever_new_messages_are_a_flood_too(self, limit: RepeatLimit) -> None:
        said = [
            self.note(limit, f"message {chr(65 + i // 26)}{chr(65 + i % 26)}", "uvicorn.error")
            for i in range(500)
        ]
        assert sum(note is not None for note in said) == MAX_CAUSES + 1
        assert self.note(limit, "our own") == ""
        self.now_s += LOG_REPEAT_S
        assert limit.due() == [
            f"uvicorn: many different messages ({500 - MAX_CAUSES - 1} more like it in {LOG_REPEAT_S:g} s)"
        ]
        assert limit.due() == []

    def test_what_informs_is_not_held_back(self, limit: RepeatLimit) -> None:
        assert [self.note(limit, "measuring", level=logging.INFO) for _ in range(3)] == ["", "", ""]
