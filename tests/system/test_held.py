"""No value is valid with an old age, not for an instant, when a daemon was held and is resumed."""

import http.client
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.held import hold
from support.played_unit import PlayedUnit
from support.ports import free_port
from support.recordings import write_beams
from support.unit_toml import write_config

pytestmark = pytest.mark.waits

STALE_AFTER_S = 1.0
HALF_A_WINDOW_S = 0.1
HOLD_S = 4.0
"""Longer than any frame may wait; a hold of 10 s shows the same."""


@pytest.fixture(scope="module")
def folder(played_unit: PlayedUnit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("held")
    shutil.copy(played_unit.calibration, folder / "cal.json")
    write_beams(folder / "beam", [(2.0, -3.0, 0.01, 0.02)], exposures=40)
    return folder


def is_valid(port: int) -> bool:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20.0)
    try:
        connection.request("GET", "/api/measurement")
        return bool(json.loads(connection.getresponse().read()).get("valid"))
    except OSError:
        return False
    finally:
        connection.close()


def await_valid(port: int, within_s: float = 60.0) -> None:
    deadline_s = time.monotonic() + within_s
    while not is_valid(port):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def test_a_daemon_that_was_held_never_calls_an_old_value_valid(folder: Path, tmp_path: Path) -> None:
    """Takes 4 s of holding and 3 s of polling while it wakes."""
    modbus_port, http_port = free_port(), free_port()
    faces = (
        f'[modbus_tcp]\nhost = "127.0.0.1"\nport = {modbus_port}\n'
        f'[http]\nhost = "127.0.0.1"\nport = {http_port}\n'
    )
    config = write_config(tmp_path / "altd.toml", folder / "cal.json", folder / "beam", faces)
    with subprocess.Popen(
        [sys.executable, "-m", "altd.cli", "run", "--rehearsal", "--config", config]
    ) as process:
        try:
            await_valid(http_port)
            answers = hold(process.pid, modbus_port, http_port, HOLD_S, polls_s=3.0)
            old = [each for each in answers if each.valid and each.age_s > STALE_AFTER_S + HALF_A_WINDOW_S]
            assert old == []
            assert any(not each.valid for each in answers)
            assert {each.face for each in answers} == {"modbus", "http"}
            await_valid(http_port)
        finally:
            process.kill()
