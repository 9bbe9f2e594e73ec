"""The daemon and its log: it is not waited for, and not flooded. Standard error is a real pipe."""

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


@pytest.fixture
def full_pipe() -> Iterator[int]:
    """The end to write to of a pipe without a reader that takes nothing more."""
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


def test_a_full_pipe_holds_neither_measuring_nor_the_end(
    played_unit: PlayedUnit, full_pipe: int, tmp_path: Path
) -> None:
    with playing(played_unit, tmp_path, full_pipe) as daemon:
        daemon.wait_until_valid()
        daemon.wait_for_measurements(10)
        daemon.process.send_signal(signal.SIGTERM)
        assert daemon.process.wait(30) == 0


def test_a_full_pipe_does_not_hold_a_refusal(full_pipe: int, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "altd.cli", "run", "--config", str(tmp_path / "none.toml")],
        stderr=full_pipe,
        timeout=200,
        check=False,
    )
    assert done.returncode == 2


@pytest.mark.real_time
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
        _, said = daemon.process.communicate(timeout=30)
        assert daemon.process.returncode == 0
    assert b"Traceback" not in said
    assert len(said.splitlines()) <= 8, said.decode()


def test_a_daemon_needs_no_standard_stream(played_unit: PlayedUnit, tmp_path: Path) -> None:
    def close() -> None:
        for descriptor in (0, 1, 2):
            os.close(descriptor)

    with playing(played_unit, tmp_path, subprocess.DEVNULL, close) as daemon:
        daemon.wait_until_valid()
        daemon.process.send_signal(signal.SIGTERM)
        assert daemon.process.wait(30) == 0
