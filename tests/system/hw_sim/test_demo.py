import fcntl
import http.client
import json
import os
import re
import select
import shlex
import shutil
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.cli import altd
from support.documented import commands_of
from support.places import ROOT
from support.ports import free_port

pytestmark = pytest.mark.alone

DEMO = [sys.executable, "-m", "hw_sim", "demo", "--seed", "3"]
NUMBER = r"([+-]?\d+\.\d+)"


class Output:
    """The output of a descriptor, read with a long timeout."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self.data = b""

    def until(self, enough: Callable[[bytes], object], timeout_s: float = 60.0) -> bytes:
        deadline = time.monotonic() + timeout_s
        while not enough(self.data):
            left = deadline - time.monotonic()
            assert left > 0, self.data.decode(errors="replace")[-3000:]
            if select.select([self._descriptor], [], [], left)[0]:
                self.data += os.read(self._descriptor, 65536)
        return self.data


@pytest.fixture
def temporary(tmp_path: Path) -> Iterator[dict[str, str]]:
    """The environment of a demo whose temporary files must be gone at the end."""
    yield {**os.environ, "TMPDIR": str(tmp_path), "LANG": "C.UTF-8"}
    assert list(tmp_path.iterdir()) == []


@contextmanager
def ended(process: subprocess.Popen[bytes]) -> Iterator[None]:
    try:
        yield
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


@contextmanager
def opened(device: str) -> Iterator[Callable[[bytes, Callable[[bytes], object]], bytes]]:
    """Says something on a serial line and gives back what it hears."""
    descriptor = os.open(device, os.O_RDWR | os.O_NOCTTY)

    def ask(question: bytes, enough: Callable[[bytes], object]) -> bytes:
        os.write(descriptor, question)
        return Output(descriptor).until(enough, timeout_s=20.0)

    try:
        yield ask
    finally:
        os.close(descriptor)


def get(port: int, path: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    connection.request("GET", path)
    answer = connection.getresponse()
    assert answer.status == 200
    return answer


def quantities(measurement: dict[str, Any]) -> list[float]:
    return [measurement[key] for key in ("x_mm", "y_mm", "yaw_deg", "pitch_deg")]


def rows_of(data: bytes) -> dict[int, str]:
    """The screen of a terminal: the last text that was written to each row."""
    drawn = re.findall(r"\x1b\[(\d+);1H\x1b\[[\d;]*m([^\x1b]*)", data.decode(errors="replace"))
    return {int(row): text for row, text in drawn}


@contextmanager
def demo_at_a_terminal(
    arguments: Sequence[str], folder: Path
) -> Iterator[tuple[int, subprocess.Popen[bytes]]]:
    """A demo on a terminal of 80 columns and 24 rows; yields our end of the terminal and the process."""
    terminal, device = os.openpty()
    try:
        fcntl.ioctl(device, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        before = termios.tcgetattr(device)
        name = os.ttyname(device)
        # the leader of a session gets the first terminal that it opens as its own
        command = f"exec {shlex.join(arguments)} <{name} >{name} 2>&1"
        environment = {**os.environ, "TMPDIR": "/tmp", "LANG": "C.UTF-8"}
        demo = subprocess.Popen(["sh", "-c", command], start_new_session=True, env=environment, cwd=folder)
        with ended(demo):
            yield terminal, demo
        assert termios.tcgetattr(device) == before
    finally:
        os.close(device)
        os.close(terminal)


def test_a_plate_is_measured_at_rest_and_on_its_way_with_the_errors_that_sigma_states(
    temporary: dict[str, str],
) -> None:
    command = [sys.executable, "-m", "hw_sim", "planar", "--seed", "4"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, env=temporary)
    with ended(process):
        assert process.stdout is not None
        output = Output(process.stdout.fileno())
        said = output.until(lambda data: data.count(b"exposure") >= 8, timeout_s=120.0).decode()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    lines = [line for line in said.splitlines() if "exposure" in line]
    for line in lines[:8]:
        sigmas, errors = re.findall(rf"± *{NUMBER}", line), re.findall(r" ([+-]\d\.\d{4})", line)
        assert len(sigmas) == len(errors[-3:]) == 3
        for sigma, error in zip(sigmas, errors[-3:], strict=True):
            assert abs(float(error)) < 5 * float(sigma)
    assert any("1 exposure" in line and "exposures" not in line for line in lines), "it never moved"


def test_a_person_at_a_terminal_blocks_the_beam_and_leaves(tmp_path: Path) -> None:
    """A unit that the demo calibrates first."""
    with demo_at_a_terminal(DEMO, tmp_path) as (terminal, demo):
        output = Output(terminal)

        def showing(text: str, quantities: dict[int, str]) -> Callable[[bytes], bool]:
            """The text, and rows that are so: while it is drawn, one row is there before another."""

            def shows(data: bytes) -> bool:
                rows = rows_of(data)
                return any(text in row for row in rows.values()) and all(
                    re.fullmatch(pattern, rows.get(number, "")) for number, pattern in quantities.items()
                )

            return shows

        names = enumerate(("x     mm", "y     mm", "yaw   deg", "pitch deg"), start=3)
        measured = {number: rf"  {name}( +{NUMBER}){{5}}" for number, name in names}
        output.until(showing("VALID, mean of 20 exposures; simulated", measured), timeout_s=120.0)
        rows = rows_of(output.data)
        assert len(rows) == 24, "made for 80 columns and 24 rows"
        assert all(len(row) < 80 for row in rows.values())
        assert termios.tcgetattr(terminal)[3] & termios.ECHO == 0

        os.write(terminal, b"b")
        truth_alone = {3: rf"  x     mm +- +- +{NUMBER} +- +-"}
        not_valid = "NOT VALID: front_spot_missing, rear_spot_missing, simulated"
        output.until(showing(not_valid, truth_alone))
        rows = rows_of(output.data)
        url = re.search(r"127.0.0.1:(\d+)/api/measurement", "\n".join(rows.values()))
        folder = re.search(r"cd (/tmp/altd-\w+) && ./altd watch --socket altd.sock", "\n".join(rows.values()))
        assert url
        assert folder
        assert Path(folder[1], "altd.sock").is_socket()
        answer = json.load(get(int(url[1]), "/api/measurement"))
        assert answer["valid"] is False
        assert quantities(answer) == [None] * 4

        os.write(terminal, b"c")
        output.until(lambda data: b"VALID, mean" in data[data.rindex(b"NOT VALID") :])
        os.write(terminal, b"q")
        output.until(lambda data: b"difference / sigma" in data and data.endswith(b"\r\n"))
        assert demo.wait(30) == 0
    assert not Path(folder[1]).exists()
    farewell = output.data[output.data.rindex(b"\x1b[?1049l") :]
    assert b"\x1b[?25h" in output.data[output.data.rindex(b"\x1b[?25l") :]
    assert b"The demo has ended" in farewell
    assert b"Traceback" not in output.data


def test_the_tutorial_works_as_it_is_written(unit_3: Path, tmp_path: Path) -> None:
    """Its commands in its order, on a unit that is calibrated already; picocom is a serial line here."""
    http_port, modbus_port = free_port(), free_port()
    changes = {
        ".venv/bin/": f"{Path(sys.executable).parent}/",
        "examples/": f"{ROOT}/examples/",
        "8080": str(http_port),
        "5020": str(modbus_port),
        "SIM-1": "SIM-3",
    }

    def command(line: str) -> str:
        for written, here in changes.items():
            line = line.replace(written, here)
        return line

    start, http, modbus, telegram, status, keep, events, replay, console, *_ = map(
        command, commands_of("first-hour.md")[1:]
    )

    def shows(line: str, text: str) -> bytes:
        """Runs a command until its output has the text."""
        process = subprocess.Popen(["bash", "-c", f"exec {line}"], cwd=tmp_path, stdout=subprocess.PIPE)
        with ended(process):
            assert process.stdout is not None
            return Output(process.stdout.fileno()).until(lambda data: text.encode() in data)

    (tmp_path / "trial").mkdir()
    shutil.copy(unit_3 / "cal.json", tmp_path / "trial" / "calibration.json")
    demo_3 = [*shlex.split(start), "--seed", "3", "--calibration", "trial/calibration.json"]
    with demo_at_a_terminal(demo_3, tmp_path) as (terminal, demo):
        output = Output(terminal)
        output.until(lambda data: b"VALID, mean of 20" in data and b"picocom" in data)
        shown = "\n".join(rows_of(output.data).values())
        changes["/dev/pts/2"] = re.search(r"cat (/dev/pts/\d+)", shown)[1]  # type: ignore[index]
        changes["/dev/pts/4"] = re.search(r"picocom (/dev/pts/\d+)", shown)[1]  # type: ignore[index]

        shows(http, '"valid": true, "status": ["simulated", "rehearsal"]')
        shows(modbus, " deg (good)\n")
        shows(modbus.removesuffix(" --rehearsal"), "no value (not live)\n")
        shows(command(telegram), ",S,")

        os.write(terminal, b"b")
        output.until(lambda data: b"NOT VALID: front_spot_missing" in data)
        shows(http, '"valid": false, "status": ["front_spot_missing", "rear_spot_missing"')
        shows(modbus, "no value (not valid: front_spot_missing)\n")
        shows(command(telegram), "front_spot_missing+rear_spot_missing")
        shows(status, "  - no laser spot (front) [")
        shows(keep, '"why":"asked by http 127.0.0.1"')
        kept = shows(f"{events} --follow", "frames saved: spot_missing ")
        assert b"front: no laser spot: " in kept
        first = "rear" if b"spot_missing rear" in kept else "front"  # a beam may go between their exposures
        shows(replay.replace("-front", f"-{first}"), ",false,front_spot_missing rear_spot_missing simulated,")

        os.write(terminal, b"c")
        for key, verdict in ((b"", b": good"), (b"m", b": bad: rear: the picture moved"), (b"c", b": good")):
            os.write(terminal, key)
            time.sleep(0.5)
            with opened(shlex.split(command(console))[1]) as ask:
                ask(b"selfcheck now\r", lambda data: b"(y: yes)" in data)
                assert verdict in ask(b"y", lambda data: data.endswith(b"> "))
        os.write(terminal, b"q")
        output.until(lambda data: b"difference / sigma" in data and data.endswith(b"\r\n"))
        assert demo.wait(30) == 0


def test_a_folder_that_is_kept_goes_on_with_the_next_demo(tmp_path: Path, unit_3: Path) -> None:
    folder = tmp_path / "kept"
    for _ in range(2):
        shown = altd(
            "demo", "--seed", "3", "--calibration", unit_3 / "cal.json", "--keep", folder, "--seconds", "4",
            module="hw_sim",
        )  # fmt: skip
        assert (shown.status, shown.err) == (0, "")
    assert {path.name for path in folder.iterdir()} == {"history.db", "history.db.lock", "recordings"}
    told = altd("events", "--history", folder / "history.db", "--format", "jsonl").out
    kinds = [json.loads(line)["kind"] for line in told.splitlines()]
    assert (kinds.count("started"), kinds.count("stopped"), kinds.count("not_ended")) == (2, 2, 0)
