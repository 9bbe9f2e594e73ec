"""Simulated frames are known as such at the end of every way that data can take.

The ways: a camera or the simulator's own recorders, a recording, its playback, a recording of the playback, a
scan, a flat or a plate, a calibration, its report, and what is measured, on each interface.
"""

import asyncio
import contextlib
import json
import os
import re
import socket
import struct
import subprocess
import sys
import time
import tty
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.cli import altd_here
from support.foreign import need_program
from support.mqtt import mosquitto
from support.opcua import Written, connected
from support.opcua import read as read_nodes
from support.own_network import inside
from support.plates import View, plate_light, write_plate
from support.played_unit import PlayingDaemon
from support.ports import free_port
from support.recordings import header, quiet, write_beams, write_scan
from support.unit_toml import write_config

from altd.calibration.file import load_calibration, save_calibration
from altd.publish.opcua.quality import Status
from altd.reasons import Signal
from altd.records import Origin
from benchmarks.live.parts import FRONT, REAR, both_cameras
from benchmarks.live.parts import write_config as write_live_config
from benchmarks.live.watch import Ports
from hw_sim.beam import BeamPose
from hw_sim.flat import record_flat
from hw_sim.measure import record_measurement
from hw_sim.plate import Plate, record_plate, with_plate
from hw_sim.scan import STAGE_STREAM, record_scan
from hw_sim.stage import Stage
from hw_sim.unit import Unit, UnitConfig

BEAMS = [(10.0, 5.0, 0.02, -0.03)] * 3
CAMERAS = ("front", "rear")
CAMERA = Origin.CAMERA


def said_to_be(recording: Path, *origins: str) -> Path:
    """The recording, its cameras' origins written into its header."""
    about = json.loads((recording / "recording.json").read_text())
    about["cameras"] = {
        name: {**about["cameras"][name], "origin": origin}
        for name, origin in zip(CAMERAS, origins, strict=True)
    }
    (recording / "recording.json").write_text(json.dumps(about))
    return recording


def origins(recording: Path) -> list[str | None]:
    cameras = json.loads((recording / "recording.json").read_text())["cameras"]
    return [cameras[name].get("origin") for name in CAMERAS]


def calibrated(recording: Path, output: Path, *more: object) -> dict[str, Any]:
    outcome = altd_here("calibrate", recording, "-o", output, *more)
    assert outcome.status == 0, outcome.err
    document: dict[str, Any] = json.loads(output.read_text())
    simulated = "simulated" in {
        entry["origin"] for target in document["targets"] for entry in (target, target["flat"] or target)
    }
    assert ("made from SIMULATED frames" in outcome.out) == simulated
    return document


def target_origins(calibration: dict[str, Any]) -> list[str]:
    return [target["origin"] for target in calibration["targets"]]


@dataclass(frozen=True)
class Files:
    """Recordings of two units that show the same, one real and one simulated, and their calibrations."""

    folder: Path
    real_calibration: Path = field(init=False)
    simulated_calibration: Path = field(init=False)

    def __post_init__(self) -> None:
        for name, origin in (("real", "camera"), ("simulated", "simulated")):
            said_to_be(write_scan(self.folder / name / "scan", columns=4, rows=4), origin, origin)
            said_to_be(write_beams(self.folder / name / "beams", BEAMS), origin, origin)
            output, report = self.folder / f"{name}.json", self.folder / name / "report"
            made = calibrated(self.folder / name / "scan", output, "--report", report)
            assert target_origins(made) == [origin, origin]
            object.__setattr__(self, f"{name}_calibration", output)

    def beams(self, name: str) -> Path:
        return self.folder / name / "beams"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("altd.calibration.report.html.svg", lambda *_: b"<svg></svg>")  # drawings take seconds
        return Files(tmp_path_factory.mktemp("origin"))


class TestReplay:
    @pytest.mark.parametrize("frames", ["real", "simulated"])
    @pytest.mark.parametrize("calibration", ["real", "simulated"])
    def test_says_simulated_when_frames_or_calibration_are(
        self, files: Files, frames: str, calibration: str
    ) -> None:
        fitted = files.folder / f"{calibration}.json"
        lines = altd_here("replay", files.beams(frames), "--calibration", fitted, "--window", "4").objects
        assert any(line["valid"] for line in lines)
        assert any(not line["valid"] for line in lines)
        expected = "simulated" in (frames, calibration)
        assert {"simulated" in line["status"] for line in lines} == {expected}

    def test_of_one_simulated_camera_says_so(self, files: Files, tmp_path: Path) -> None:
        beams = said_to_be(write_beams(tmp_path / "beams", BEAMS), "camera", "simulated")
        lines = altd_here("replay", beams, "--calibration", files.real_calibration).objects
        assert all("simulated" in line["status"] for line in lines)

    def test_of_a_recording_that_says_nothing_counts_as_cameras(self, files: Files, tmp_path: Path) -> None:
        beams = write_beams(tmp_path / "beams", BEAMS)
        assert origins(beams) == [None, None]
        lines = altd_here("replay", beams, "--calibration", files.real_calibration, "--window", "4").objects
        assert {code for line in lines for code in line["status"]} == {"warming_up"}

    def test_of_an_unknown_origin_is_refused(self, files: Files, tmp_path: Path) -> None:
        beams = said_to_be(write_beams(tmp_path / "beams", BEAMS), "camera", "dreamt")
        outcome = altd_here("replay", beams, "--calibration", files.real_calibration)
        assert outcome.status == 2
        assert "recording.json: cameras.rear.origin: " in outcome.err


class TestCalibration:
    def test_of_one_simulated_camera_marks_that_target(self, tmp_path: Path) -> None:
        scan = said_to_be(write_scan(tmp_path / "scan", columns=4, rows=4), "simulated", "camera")
        assert target_origins(calibrated(scan, tmp_path / "cal.json")) == ["simulated", "camera"]

    def test_through_a_simulated_flat_is_simulated(self, files: Files, tmp_path: Path) -> None:
        flat = tmp_path / "flat"
        flat.mkdir()
        (flat / "recording.json").write_text(json.dumps(header("flat")))
        rows = ["sequence,t_s,camera,file,leds,x_mm,y_mm"]
        for name in CAMERAS:
            grain = np.random.default_rng(1).normal(120, 4, (480, 752))
            cv2.imwrite(str(flat / f"{name}.png"), np.clip(grain, 0, 255).astype(np.uint8))
            rows.append(f"0,0.0,{name},{name}.png,on,,")
        (flat / "frames.csv").write_text("\n".join(rows) + "\n")
        said_to_be(flat, "simulated", "camera")
        scan, output = files.folder / "real" / "scan", tmp_path / "cal.json"
        targets = calibrated(scan, output, "--flat", flat)["targets"]
        assert [(t["origin"], t["flat"]["origin"]) for t in targets] == [
            ("camera", "simulated"),
            ("camera", "camera"),
        ]
        lines = altd_here("replay", files.beams("real"), "--calibration", output).objects
        assert all("simulated" in line["status"] for line in lines)

    def test_of_a_plate_has_its_origin(self, tmp_path: Path) -> None:
        lights = [plate_light(View(800.0, 250.0, mirrored=mirrored)) for mirrored in (True, False)]
        plate = said_to_be(write_plate(tmp_path / "plate", *lights), "simulated", "simulated")
        assert target_origins(calibrated(plate, tmp_path / "cal.json")) == ["simulated", "simulated"]

    def test_bears_it_across_every_sheet_of_its_report(self, files: Files) -> None:
        for name, marks in (("real", False), ("simulated", True)):
            folder = files.folder / name / "report"
            (pdf,), (html,) = folder.glob("*.pdf"), folder.glob("*.html")
            read = [need_program("pdftotext", "poppler-utils"), "-layout", str(pdf), "-"]
            sheets = subprocess.run(read, capture_output=True, text=True, check=True).stdout.split("\f")[:-1]
            assert len(sheets) > 2
            assert {"SIMULATED" in sheet for sheet in sheets} == {marks}
            page = html.read_text()
            assert ('<div class="mark" aria-hidden="true">SIMULATED</div>' in page) == marks
            assert ("Made from SIMULATED frames" in page) == marks


@contextlib.contextmanager
def line_to(device_of: Callable[[str], None]) -> Iterator[int]:
    """The far end of a serial line; ``device_of`` receives the name of the near one."""
    far, near = os.openpty()
    tty.setraw(near)
    device_of(os.ttyname(near))
    try:
        yield far
    finally:
        os.close(far)
        os.close(near)


def read_until(descriptor: int, pattern: str, timeout_s: float = 60.0) -> str:
    os.set_blocking(descriptor, False)
    text, deadline = "", time.monotonic() + timeout_s
    while re.search(pattern, text) is None:
        assert time.monotonic() < deadline, text
        with contextlib.suppress(BlockingIOError):
            text += os.read(descriptor, 4096).decode()
        time.sleep(0.01)
    return text


@pytest.mark.parametrize(
    ("frames", "calibration", "rehearsal"),
    [("simulated", "real", True), ("real", "simulated", False)],
)
def test_every_interface_of_the_daemon_says_it_and_only_a_rehearsal_gives_valid_values(
    files: Files, tmp_path: Path, frames: str, calibration: str, rehearsal: bool
) -> None:
    """Played: what is marked as simulated stays so, beside being played."""
    said = {"playback", "simulated"} | ({"rehearsal"} if rehearsal else {"not_live"})
    devices: list[str] = []
    http, modbus, opcua = free_port(), free_port(), free_port()
    with (
        line_to(devices.append) as telegram,
        line_to(devices.append) as console,
        mosquitto(tmp_path, "allow_anonymous true") as (broker, _),
    ):
        faces = f'[http]\nhost = "127.0.0.1"\nport = {http}\n'
        faces += f'[modbus_tcp]\nhost = "127.0.0.1"\nport = {modbus}\n'
        faces += f'[opcua]\nhost = "127.0.0.1"\nport = {opcua}\n'
        faces += f'[mqtt]\nhost = "127.0.0.1"\nport = {broker}\nevery_measurement = true\n'
        for device, speaks in zip(devices, ("telegram", "console"), strict=True):
            faces += f'[[serial]]\ndevice = "{device}"\nspeaks = "{speaks}"\nbaud = 115200\n'
        fitted, beams = files.folder / f"{calibration}.json", files.beams(frames)
        config = write_config(tmp_path / "altd.toml", fitted, beams, faces)
        checked, examined = altd_here("check-config", config).out, altd_here("doctor", "--config", config).out
        assert ("SIMULATED" in checked) == (calibration == "simulated")
        assert ("SIMULATED" in examined) == (calibration == "simulated")
        command = [sys.executable, "-m", "altd.cli", "run", "--config", str(config)]
        command += ["--rehearsal"] * rehearsal
        daemon = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            mode = "S" if rehearsal else "V"  # since many exposures there is no other reason
            sent = read_until(telegram, rf"\$PALTM,[^\n]*,{mode},\d\d+,[^\n]*\n\$PALTQ,\d\d+,[^\n]*\n")
            assert all(code in sent.splitlines()[-1] for code in said)
            measured = PlayingDaemon(daemon, http, modbus).wait_until(
                lambda measurement: set(measurement["status"]) == said
            )
            assert measured["valid"] == rehearsal
            assert (measured["x_mm"] is not None) == rehearsal
            with urllib.request.urlopen(f"http://127.0.0.1:{http}/api/stream", timeout=20) as stream:
                event = next(line for line in stream if line.startswith(b"data:"))
            streamed = json.loads(event.removeprefix(b"data:"))
            assert (streamed["valid"], set(streamed["status"])) == (rehearsal, said)
            with urllib.request.urlopen(f"http://127.0.0.1:{http}/api/status", timeout=20) as page:
                status = json.load(page)
            assert ("SIMULATED" in status["calibration"]) == (calibration == "simulated")
            assert said <= {cause["code"] for cause in status["state"]["causes"]}
            for topic in ("measurement", "summary"):
                published = json.loads(_next_message(broker, topic))
                assert said <= set(published["status"])
                x_mm = published["x_mm"]["mean"] if topic == "summary" else published["x_mm"]
                assert (x_mm is not None) == rehearsal
            by_opcua = asyncio.run(_nodes(opcua, said))
            assert by_opcua["valid"].value == rehearsal
            expected = Status.UNCERTAIN_SIMULATED_VALUE if rehearsal else Status.BAD_OUT_OF_SERVICE
            assert by_opcua["x_mm"].status is expected
            assert by_opcua["health"].value == Signal.CHECK_FUNCTION.number
            os.write(console, b"status\r")
            read_until(console, "SIMULATED, not live")
            played, not_trusted = 0b11 << 12, 1 << 15
            assert int.from_bytes(_registers(modbus, 0, 1)) == played | (1 if rehearsal else not_trusted)
            unit = _registers(modbus, 300, 50)
            checksum = json.loads(fitted.read_text())["checksum"].removeprefix("sha256:")
            assert (unit[24:28].hex(), unit[48:54]) == (checksum[:8], b"TEST-1")
            assert unit[2:4] == bytes([0, rehearsal])
            assert unit[28:32].hex() == sha256(config.read_bytes()).hexdigest()[:8]
            condition = _registers(modbus, 400, 60)
            assert condition[:4] == bytes([0, 1, 0, Signal.CHECK_FUNCTION.number])
            diameter_px, peak = struct.unpack(">2f", condition[36:44])
            assert diameter_px > 10
            assert peak > 10
        finally:
            daemon.kill()
            daemon.wait()


async def _nodes(port: int, said: set[str]) -> dict[str, Written]:
    """The readings of asyncua's client, once the server has these reasons.

    On a busy machine the unit may start its server again: a client connects again then.
    """
    async with asyncio.timeout(200):
        while True:
            with contextlib.suppress(ConnectionError):
                async with connected(f"opc.tcp://127.0.0.1:{port}") as client:
                    while True:
                        found = await read_nodes(client, "x_mm", "valid", "status", "health")
                        if found["status"].value is not None and set(found["status"].value) == said:
                            return found
                        await asyncio.sleep(0.05)
            await asyncio.sleep(0.05)


def _next_message(port: int, topic: str) -> str:
    command = [need_program("mosquitto_sub", "mosquitto-clients"), "-p", str(port), "-C", "1", "-W", "20"]
    return subprocess.run(
        [*command, "-t", f"altd/+/{topic}"], capture_output=True, text=True, check=True
    ).stdout


def _registers(port: int, address: int, count: int) -> bytes:
    """Input registers of unit 1, asked by hand (Modbus TCP, function 4)."""
    with socket.create_connection(("127.0.0.1", port), timeout=20) as line:
        line.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, address, count))
        answer = b""
        while len(answer) < 9 + 2 * count:
            answer += (more := line.recv(512))
            assert more, "closed"
    assert answer[7] == 4, answer.hex()
    return answer[9:]


class TestRecord:
    def test_of_a_playback_keeps_the_recordings_own_origin(self, files: Files, tmp_path: Path) -> None:
        for name, origin in (("real", "camera"), ("simulated", "simulated")):
            config = write_config(tmp_path / f"{name}.toml", files.real_calibration, files.beams(name))
            copy = tmp_path / name
            assert altd_here("record", "--config", config, "-o", copy, "--seconds", "0.3").status == 0
            assert origins(copy) == [origin, origin]
            about = json.loads((copy / "recording.json").read_text())
            assert about["note"] == "altd record, playback" + ", simulated" * (name == "simulated")
            assert about["made_by"].startswith("altd ")

    @pytest.mark.own_network
    def test_of_simulated_gige_cameras_is_simulated_to_its_last_measurement(
        self, simulated_unit: Callable[[int], Path], tmp_path: Path
    ) -> None:
        if not inside():
            return
        known, fitted = load_calibration(simulated_unit(1) / "cal.json"), tmp_path / "cal.json"
        targets = [
            replace(target, origin=CAMERA, flat=target.flat and replace(target.flat, origin=CAMERA))
            for target in known.targets
        ]
        save_calibration(replace(known, targets=tuple(targets)), fitted)
        assert not load_calibration(fitted).simulated
        config = write_live_config(tmp_path / "altd.toml", "SIM-1", fitted, (FRONT, REAR), Ports(8080, 5020))
        with both_cameras(tmp_path):
            outcome = altd_here("record", "--config", config, "-o", tmp_path / "kept", "--seconds", "1")
        assert outcome.status == 0
        assert re.fullmatch(rf"\d+ exposures? in {tmp_path / 'kept'}\n", outcome.err)
        assert origins(tmp_path / "kept") == ["simulated", "simulated"]
        about = json.loads((tmp_path / "kept" / "recording.json").read_text())["cameras"]["front"]
        assert about["driver"] == "aravis"
        assert about["serial"]
        assert about["exposure_ms"] > 0
        assert about["gain_db"] >= 0
        lines = altd_here("replay", tmp_path / "kept", "--calibration", fitted, "--window", "4").objects
        assert lines
        assert all("simulated" in line["status"] for line in lines)


def test_all_that_the_simulator_records_is_simulated(tmp_path: Path) -> None:
    unit, plate = Unit(UnitConfig(seed=1)), Plate()
    record_flat(tmp_path / "flat", unit, 1, quiet)
    record_scan(tmp_path / "scan", unit, Stage(np.random.default_rng([1, STAGE_STREAM])), 1, quiet)
    record_measurement(tmp_path / "measurement", unit, [BeamPose(0.0, 0.0)], 1, quiet)
    record_plate(tmp_path / "plate", with_plate(unit, plate), plate, 1, quiet)
    for folder in tmp_path.iterdir():
        assert origins(folder) == ["simulated", "simulated"], folder.name
