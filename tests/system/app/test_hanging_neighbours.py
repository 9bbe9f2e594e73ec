"""Neighbours that do not answer: they neither stop the daemon nor delay its end."""

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.cli import altd
from support.fleet import fleet_toml, postgresql
from support.played_unit import PlayedUnit, PlayingDaemon
from support.ports import free_port
from support.unit_toml import write_config

END_TIMEOUT_S = 10.0
"""Time after which systemd kills the daemon (``TimeoutStopSec``)."""

HANGING = """
import ctypes, pkgutil, sys
place, name = sys.argv.pop(1), sys.argv.pop(1)
def hang(*_, **__):
    print("hangs", flush=True)
    mutex, lock = ctypes.create_string_buffer(64), ctypes.CDLL(None).pthread_mutex_lock
    lock(mutex)
    lock(mutex)  # never returns, not even for a signal
setattr(pkgutil.resolve_name(place), name, hang)
from altd.cli.main import main
sys.exit(main())
"""

MQTT = '[mqtt]\nhost = "broker.example"\n'
SERIAL = '[[serial]]\ndevice = "/dev/altd-none"\nspeaks = "telegram"\n'
HISTORY = '[history]\nfile = "history.db"\n'
INCLINOMETER = '[inclinometer]\ndriver = "balluff_bsi_r11a0"\ndevice = "/dev/altd-none"\n'


@contextlib.contextmanager
def hanging(call: str, folder: Path, *arguments: object) -> Iterator[subprocess.Popen[bytes]]:
    """A command of altd in which one function never returns."""
    process = subprocess.Popen(
        [sys.executable, "-c", HANGING, *call.split(), *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "STATE_DIRECTORY": str(folder)},
    )
    with process:
        try:
            yield process
        finally:
            process.kill()


def assert_hangs_and_ends(process: subprocess.Popen[bytes]) -> None:
    assert process.stdout is not None
    assert select.select([process.stdout], [], [], 60.0)[0], "the function was not called"
    begun_s = time.monotonic()
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == 0
    assert time.monotonic() - begun_s < END_TIMEOUT_S


@pytest.mark.waits
@pytest.mark.parametrize(
    ("call", "more", "path"),
    [
        pytest.param("socket getaddrinfo", MQTT, "", id="name of the broker"),
        pytest.param("altd.serial_port.port open_serial", SERIAL, "", id="serial port"),
        pytest.param("altd.devices.inclinometer.driver open_serial", INCLINOMETER, "", id="inclinometer"),
        pytest.param("sqlite3 connect", HISTORY, "", id="disk of the history"),
        pytest.param("altd.devices.playback.player:PlaybackCamera next_frame", "", "", id="camera"),
        pytest.param("altd.app.diagnostics _versions", "", "diagnostics", id="diagnostics"),
        pytest.param("altd.app.calibration_files read_file", "", "calibration/file", id="calibration"),
        pytest.param("altd.credentials.file:Credentials is_password", "", "login", id="password"),
    ],
)
def test_a_neighbour_that_hangs_does_not_delay_the_end(
    played_unit: PlayedUnit, tmp_path: Path, call: str, more: str, path: str
) -> None:
    port = free_port()
    http = f'[http]\nhost = "127.0.0.1"\nport = {port}\n'
    if path == "login":
        altd("password", tmp_path / "credentials", "ada", stdin="long enough 1\n")
        http += f'credentials = "{tmp_path}/credentials"\n'
    config = write_config(tmp_path / "altd.toml", played_unit.calibration, played_unit.beams, http + more)
    with (
        hanging(call, tmp_path, "run", "--rehearsal", "--config", config) as process,
        contextlib.closing(socket.socket()) as client,
    ):
        daemon = PlayingDaemon(process, port, 0)
        daemon.wait_until(lambda measurement: measurement["valid"] or call.endswith("next_frame"))
        if path:
            body = json.dumps({"name": "ada", "password": "long enough 1"})
            method = "POST" if path == "login" else "GET"
            head = "Host: 127.0.0.1\r\nX-Altd-Request: 1\r\nContent-Type: application/json\r\n"
            head += f"Content-Length: {len(body)}"
            client.connect(("127.0.0.1", port))
            client.sendall(f"{method} /api/v1/{path} HTTP/1.1\r\n{head}\r\n\r\n{body}".encode())
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/status", timeout=20):
            pass  # the others still answer
        assert_hangs_and_ends(process)


@pytest.mark.waits
@pytest.mark.parametrize("hangs", ["database", "broker"])
def test_a_name_that_is_not_resolved_does_not_delay_the_end_of_the_ingest(tmp_path: Path, hangs: str) -> None:
    with contextlib.ExitStack() as life:
        database = "host=database.example"
        if hangs == "broker":
            database = life.enter_context(postgresql()).new_database()
        config = fleet_toml(tmp_path, free_port(), database)
        config.write_text(config.read_text().replace('host = "127.0.0.1"', 'host = "broker.example"'))
        process = life.enter_context(hanging("socket getaddrinfo", tmp_path, "ingest", "--config", config))
        time.sleep(2.0)  # libpq aborts a process that ends while another of its threads connects
        assert_hangs_and_ends(process)
