"""SIGHUP to the real daemon: what changed is applied alone, and what is wrong changes nothing."""

import asyncio
import contextlib
import fcntl
import json
import os
import queue
import re
import shutil
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest
from paho.mqtt.client import CallbackAPIVersion, Client
from support import proof_code
from support.block_clients import RtuClient, TcpClient, telegrams
from support.mqtt import mosquitto
from support.played_unit import PlayedUnit, PlayingDaemon, playing
from support.ports import free_port
from support.unit_toml import write_config
from support.wire import Wire

from benchmarks.interfaces import raw_terminal

PROOF = proof_code.python()


class Unit:
    """A daemon without a terminal, its file, and what it logs about its settings."""

    def __init__(self, daemon: PlayingDaemon, config: Path) -> None:
        self.daemon = daemon
        self.config = config
        self.lines: list[str] = []
        self._said: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._others: list[socket.socket] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self.daemon.process.stderr is not None
        for line in self.daemon.process.stderr:
            self.lines.append(line.decode())
            if line.startswith(b"altd: settings "):
                self._said.put(line.decode().removeprefix("altd: ").rstrip())

    def reload(self, settings: str | None = None) -> None:
        """Write the settings, if any, and ask for them."""
        if settings is not None:
            self.config.write_text(settings)
        self.daemon.process.send_signal(signal.SIGHUP)

    def outcome(self) -> str:
        """The line of the next reload."""
        return self._said.get(timeout=30)

    def get(self, path: str) -> Any:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.daemon.http}{path}", timeout=20) as answer:
            return json.load(answer)

    def listen(self, host: str, port: int) -> None:
        """Listen there as another program, until the daemon has ended."""
        self._others.append(socket.create_server((host, port)))

    def end(self) -> None:
        """Stop it, within two seconds."""
        begun_s = time.monotonic()
        self.daemon.process.send_signal(signal.SIGTERM)
        assert self.daemon.process.wait(30) == 0, self.lines
        assert time.monotonic() - begun_s < 2.0
        self._reader.join()
        for other in self._others:
            other.close()
        assert not [line for line in self.lines if "Traceback" in line or "defect" in line], self.lines


@pytest.fixture
def own_unit(played_unit: PlayedUnit, tmp_path: Path) -> PlayedUnit:
    """A unit whose files the test may change."""
    shutil.copy(played_unit.calibration, tmp_path / "cal.json")
    (tmp_path / "beams").symlink_to(played_unit.beams)
    return PlayedUnit(tmp_path)


@contextlib.contextmanager
def running(unit: PlayedUnit, more: str = "") -> Iterator[Unit]:
    with playing(unit, unit.folder, subprocess.PIPE, os.setsid, more) as daemon:
        daemon.wait_until_valid()
        yield Unit(daemon, unit.folder / "altd.toml")


@dataclass
class Controller:
    """Polls the checked block 20 times a second over one connection; ``wrong`` is what it found."""

    port: int
    polls: int = 0
    slowest_s: float = 0.0
    oldest_s: float = 0.0
    wrong: list[str] = field(default_factory=list)

    @contextlib.contextmanager
    def polling(self) -> Iterator[None]:
        ends = threading.Event()
        thread = threading.Thread(target=self._poll, args=(ends,))
        thread.start()
        try:
            yield
        finally:
            ends.set()
            thread.join()

    def _poll(self, ends: threading.Event) -> None:
        client, last = TcpClient(self.port), None
        while not ends.wait(0.05):
            asked_s = time.monotonic()
            answer = client.ask(5.0)
            self.slowest_s = max(self.slowest_s, time.monotonic() - asked_s)
            self.polls += 1
            block = None if answer is None else PROOF.from_block(answer)
            if block is None:
                self.wrong.append("no answer, or a corrupt one")
                break
            self.oldest_s = max(self.oldest_s, block["age_s"])
            if last and (block["session"] != last["session"] or block["count"] < last["count"]):
                self.wrong.append(f"{block} after {last}")
            last = block
        client.close()


@pytest.mark.real_time
def test_what_changed_is_restarted_alone(own_unit: PlayedUnit, wire: Wire) -> None:
    telegram = f'[[serial]]\ndevice = "{wire.device}"\nspeaks = "telegram"\ninterval_s = 0.2\n'
    with running(own_unit) as unit:
        controller = Controller(unit.daemon.modbus)
        sha256 = unit.get("/api/status")["config_sha256"]
        with controller.polling():
            for turn in range(6):
                text, port = unit.config.read_text(), free_port()
                text = text.replace(f"port = {unit.daemon.http}\n", f"port = {port}\n")
                unit.reload(text.replace(telegram, "") if turn % 2 else text + telegram)
                assert unit.outcome() == "settings reloaded: http.port, serial"
                unit.daemon.http = port
                components = unit.get("/api/status")["components"]
                assert (f"serial {wire.device}" in components) is (turn % 2 == 0)
                assert [name for name in components if name.startswith("http")] == [f"http 127.0.0.1:{port}"]
        print(controller)
        assert controller.wrong == []
        assert controller.polls > 15
        assert controller.slowest_s < 0.5
        assert controller.oldest_s < 1.0
        assert unit.get("/api/status")["config_sha256"] != sha256
        assert b"$PALT" in os.read(wire.far, 65536)
        unit.end()


CHANGES = {
    "[modbus_tcp]\n": "allow_self_check = true\n",
    "[http]\n": 'names = ["unit"]\n',
    "[mqtt]\n": 'home_assistant = "homeassistant"\n',
    'speaks = "telegram"\n': "identify_every_s = 3600\n",
    'speaks = "modbus_rtu"\n': "allow_zero = true\n",
}
"""For each interface a line of its table, and one that a reload adds after it; no client is concerned."""


@pytest.mark.real_time
def test_no_reader_is_locked_out_by_a_reload(own_unit: PlayedUnit, tmp_path: Path) -> None:
    lines, heard = [raw_terminal() for _ in range(2)], queue.SimpleQueue[bytes]()
    subscriber = Client(CallbackAPIVersion.VERSION2)
    subscriber.on_connect = lambda client, *_: client.subscribe("altd/+/measurement")
    subscriber.on_message = lambda _client, _data, message: heard.put(message.payload)
    with mosquitto(tmp_path, "allow_anonymous true") as (broker, _):
        subscriber.connect("127.0.0.1", broker)
        subscriber.loop_start()
        telegram, rtu = (
            f'[[serial]]\ndevice = "{os.ttyname(near)}"\nbaud = 115200\nspeaks = "{speaks}"\n'
            for (_, near), speaks in zip(lines, ("telegram", "modbus_rtu"), strict=True)
        )
        mqtt = f'[mqtt]\nhost = "127.0.0.1"\nport = {broker}\nevery_measurement = true\n'
        with running(own_unit, mqtt + telegram + "checked = true\ninterval_s = 0.1\n" + rtu) as unit:
            polled, polled_rtu = TcpClient(unit.daemon.modbus), RtuClient(lines[1][0])
            sentences = telegrams(lines[0][0])
            measurement = f"http://127.0.0.1:{unit.daemon.http}/api/measurement"
            wires: dict[str, Callable[[], Any]] = {
                "modbus_tcp": lambda: PROOF.from_block(polled.ask(5.0)),
                "modbus_rtu": lambda: PROOF.from_block(polled_rtu.ask(5.0)),
                "telegram": lambda: PROOF.from_telegram(next(sentences)),
                "http": lambda: PROOF.from_json(urllib.request.urlopen(measurement, timeout=20).read()),
                "mqtt": lambda: PROOF.from_json(heard.get(timeout=20)),
            }
            checks = {wire: PROOF.Check(crc32(b"TEST-1"), 5.0) for wire in wires}
            for reloads in range(3):
                now_ms = wires["modbus_tcp"]()["clock_ms"]
                for wire, take in wires.items():
                    is_of_now = False
                    while not is_of_now:  # earlier ones wait on some wires
                        message = take()
                        fault = checks[wire].fault(message, time.monotonic())
                        assert fault == "not valid", (wire, reloads, fault)  # as all that is played
                        is_of_now = message["clock_ms"] > now_ms + 500
                text = unit.config.read_text()
                for line, more in CHANGES.items():
                    text = text.replace(line + more, line) if reloads % 2 else text.replace(line, line + more)
                unit.reload(text)
                keys = "modbus_tcp.allow_self_check, mqtt.home_assistant, http.names, serial"
                assert sorted(unit.outcome().partition(": ")[2].split(", ")) == sorted(keys.split(", "))
                polled.close()
            unit.end()
        subscriber.loop_stop()


def missing_calibration(unit: Unit) -> str:
    (unit.config.parent / "cal.json").unlink()
    return unit.config.read_text()


def other_calibration(unit: Unit) -> str:
    path = unit.config.parent / "cal.json"
    path.write_text(path.read_text() + " ")
    return unit.config.read_text()


def taken_address(unit: Unit) -> str:
    """Another program has it; a key of Modbus could be changed."""
    unit.listen("127.0.0.1", port := free_port())
    text = unit.config.read_text().replace(f"port = {unit.daemon.http}\n", f"port = {port}\n")
    return text.replace("[modbus_tcp]\n", "[modbus_tcp]\nunit_id = 9\n")


def taken_on_the_same_port(unit: Unit) -> str:
    """The port is our own, and another program has it at the new address."""
    unit.listen("127.0.0.2", unit.daemon.http)
    ours = f"\nport = {unit.daemon.http}"
    return unit.config.read_text().replace(f'"127.0.0.1"{ours}', f'"127.0.0.2"{ours}')


FAULTS: dict[str, tuple[Callable[[Unit], str | None], str]] = {
    "half of the file": (lambda unit: unit.config.read_text()[:-9], r"altd\.toml: line \d+, column \d+: .*"),
    "no TOML": (lambda unit: "\0", r"altd\.toml: .*"),
    "unknown key": (
        lambda unit: unit.config.read_text() + "ports = 1\n",
        r"altd\.toml: line \d+, column 1: history\.ports: .*",
    ),
    "no file": (lambda unit: unit.config.unlink(), r"altd\.toml: No such file or directory"),
    "another unit": (
        lambda unit: unit.config.read_text().replace("TEST-1", "TEST-2"),
        r"altd\.toml: unit\.serial: cannot change while the unit measures: restart altd",
    ),
    "longer window, another camera": (
        lambda unit: unit.config.read_text().replace("window = 4", "window = 5").replace("repeat = true", ""),
        r"altd\.toml: cameras\.front\.repeat: cannot change while .*: restart altd \(and 2 more: .*\)",
    ),
    "no calibration": (
        missing_calibration,
        r"altd\.toml: unit\.calibration: .*cal\.json does not exist yet; .*",
    ),
    "another calibration": (other_calibration, r"cal\.json: is not the file that was loaded: restart altd"),
    "outbox switched on": (
        lambda unit: unit.config.read_text() + '[mqtt]\nhost = "127.0.0.1"\nstore_and_forward = true\n',
        r"altd\.toml: mqtt\.store_and_forward: cannot change while the unit measures: restart altd",
    ),
    "no credentials": (
        lambda unit: unit.config.read_text().replace("[http]", '[http]\ncredentials = "none"'),
        r"none: No such file or directory.*",
    ),
    "taken address": (taken_address, r"http 127\.0\.0\.1:\d+: Address already in use.*"),
    "taken on the same port": (taken_on_the_same_port, r"http 127\.0\.0\.2:\d+: Address already in use.*"),
    "address of no interface": (
        lambda unit: unit.config.read_text().replace('"127.0.0.1"', '"192.0.2.1"'),
        r"modbus_tcp 192\.0\.2\.1:\d+: Cannot assign requested address",
    ),
}


def test_each_address_that_is_taken_at_the_start_is_served_when_it_is_free(
    own_unit: PlayedUnit, wire: Wire
) -> None:
    """One with a free address works from the start. At a taken local socket another daemon listens."""
    names = {name: free_port() for name in ("http", "modbus_tcp", "opcua")}
    more = "".join(f'[{name}]\nhost = "127.0.0.1"\nport = {port}\n' for name, port in names.items())
    more += f'[local]\nsocket = "{own_unit.folder}/s"\n'
    more += f'[[serial]]\ndevice = "{wire.device}"\nspeaks = "telegram"\ninterval_s = 0.2\n'
    config = write_config(own_unit.config, own_unit.calibration, own_unit.beams, more)
    with contextlib.ExitStack() as taken:
        for port in names.values():
            taken.enter_context(socket.create_server(("127.0.0.1", port)))
        command = [sys.executable, "-m", "altd.cli", "run", "--rehearsal", "--config", str(config)]
        process = subprocess.Popen(command, stderr=subprocess.PIPE)
        unit = Unit(PlayingDaemon(process, names["http"], names["modbus_tcp"]), config)
        try:
            measures = re.compile(rb"PALTM,[^\r]*,P,\d+,\d")
            asyncio.run(wire.receive(lambda said: measures.search(said) is not None))
            taken.close()
            unit.daemon.wait_until_valid()
            places = [f"{name} 127.0.0.1:{port}" for name, port in names.items()]
            all_places, states = [*places, f"local {own_unit.folder}/s"], {}
            deadline_s = (
                time.monotonic() + 300.0
            )  # OPC UA: 30 s between tries, and it gives way while it starts
            while set(states.values()) != {"ok"} and time.monotonic() < deadline_s:
                components = unit.get("/api/status")["components"]
                states = {place: components[place]["state"] for place in all_places}
                time.sleep(0.2)
            assert set(states.values()) == {"ok"}, states
            unit.end()
            for place in places:
                assert any(f"{place}: Address already in use by " in line for line in unit.lines), unit.lines
        finally:
            process.kill()
            process.wait()
            if process.stderr is not None:
                process.stderr.close()


def test_what_is_wrong_changes_nothing(own_unit: PlayedUnit, played_unit: PlayedUnit) -> None:
    with running(own_unit, '[history]\nfile = "history.db"\n') as unit:
        good, before, said = unit.config.read_text(), unit.get("/api/status"), []
        controller = Controller(unit.daemon.modbus)
        with controller.polling():
            for name, (make, says) in FAULTS.items():
                unit.reload(make(unit))
                said.append(unit.outcome())
                pattern = rf"settings refused, the old ones remain in use: (\S*/)?{says}"
                assert re.fullmatch(pattern, said[-1]), (name, said[-1])
                now = unit.get("/api/status")
                assert now["components"].pop("settings")["state"] == "degraded", name
                assert now["components"].keys() == before["components"].keys(), name
                assert now["config_sha256"] == before["config_sha256"], name
                shutil.copy(played_unit.calibration, own_unit.calibration)
                unit.reload(good)
                said.append(unit.outcome())
                assert said[-1] == "settings reloaded: nothing changed", name
                assert unit.get("/api/status")["components"]["settings"]["state"] == "ok"
        assert controller.wrong == []
        events = [event for event in unit.get("/api/v1/events")["events"] if event["kind"] == "config"]
        assert {event["text"] for event in events} <= set(said)
        unit.end()


def test_a_file_that_is_being_written_is_refused(own_unit: PlayedUnit) -> None:
    """The written part can be complete settings without interfaces."""
    with running(own_unit) as unit:
        ends = threading.Event()

        def write() -> None:
            text = unit.config.read_text()
            with unit.config.open("w") as file:
                file.write(text.partition("[http]")[0])
                while not ends.wait(0.02):
                    file.write("# more\n")
                    file.flush()

        writer = threading.Thread(target=write)
        writer.start()
        try:
            time.sleep(0.05)
            unit.reload()
            assert "is being written: reload again when it is complete" in unit.outcome()
        finally:
            ends.set()
            writer.join()
        unit.get("/api/status")
        unit.end()


@pytest.mark.parametrize("delay_s", [0.0, 0.1, 0.3, 0.5])
def test_it_can_be_ended_while_it_reloads(delay_s: float, own_unit: PlayedUnit) -> None:
    with running(own_unit) as unit:
        text = unit.config.read_text().replace(f"port = {unit.daemon.http}\n", f"port = {free_port()}\n")
        unit.reload(text)
        time.sleep(delay_s)
        unit.end()


def test_many_requests_are_few_reloads(own_unit: PlayedUnit) -> None:
    with running(own_unit) as unit:
        for _ in range(200):
            unit.reload()
            time.sleep(0.001)
        assert unit.outcome() == "settings reloaded: nothing changed"
        unit.daemon.wait_for_measurements(20)
        unit.end()
        assert len([line for line in unit.lines if "settings " in line]) < 50


def test_a_terminal_that_goes_away_ends_it_in_order(played_unit: PlayedUnit, tmp_path: Path) -> None:
    far, near = os.openpty()

    def control() -> None:
        os.setsid()
        fcntl.ioctl(near, termios.TIOCSCTTY, 0)

    with playing(played_unit, tmp_path, subprocess.DEVNULL, control) as daemon:
        daemon.wait_until_valid()
        os.close(near)
        os.close(far)  # the kernel sends SIGHUP
        assert daemon.process.wait(30) == 0
