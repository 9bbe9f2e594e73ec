"""Three targets on one beam, cameras with names of their own: calibrated, replayed, measured live, published.

Truth is where the beams and the stage were put, through the map of ``support.recordings``.
"""

import json
import struct
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.cli import altd_here, refusal
from support.foreign import need_program
from support.frames import HEIGHT, WIDTH
from support.played_unit import PlayingDaemon
from support.ports import free_port
from support.recordings import picture

from hw_sim.recording import STORED

Z_MM = {"front": 0.0, "middle": 140.0, "rear": 280.0}
CAMERAS = {"front": "cam_a", "middle": "cam_b", "rear": "cam_c"}
Beam = tuple[float, float, float, float]
BEAMS: list[Beam] = [(10.0, 5.0, 0.02, -0.03), (-20.0, 15.0, -0.05, 0.04)]
EXPOSURES = 4

Places = dict[str, tuple[float, float]]
"""The place of the beam on each target of a recording, mm."""


def write(path: Path, kind: str, shots: Iterable[tuple[Places, tuple[float, float] | None]]) -> Path:
    rng = np.random.default_rng(3)
    path.mkdir(parents=True)
    rows, targets = ["sequence,t_s,camera,file,leds,x_mm,y_mm"], set[str]()
    for sequence, (places, stage) in enumerate(shots):
        targets |= places.keys()
        x_mm, y_mm = stage or ("", "")
        for target, place in places.items():
            name = f"{target}{sequence:03d}.png"
            cv2.imwrite(str(path / name), picture(target, *place, rng), STORED)
            rows.append(f"{sequence},{sequence / 20:.3f},{CAMERAS[target]},{name},off,{x_mm},{y_mm}")
    size = {"width": WIDTH, "height": HEIGHT, "bits": 8}
    shown = [name for name in Z_MM if name in targets]
    document = {
        "format": "altd-recording/1",
        "kind": kind,
        "fps": 20.0,
        "cameras": {CAMERAS[name]: size for name in shown},
        "unit": {"serial": "THREE"},
        "targets": [{"name": name, "z_mm": Z_MM[name], "camera": CAMERAS[name]} for name in shown],
        "note": "written by a test",
    }
    (path / "recording.json").write_text(json.dumps(document))
    (path / "frames.csv").write_text("\n".join(rows) + "\n")
    return path


def nodes(*targets: str) -> list[tuple[Places, tuple[float, float] | None]]:
    """A scan of some of the targets: the stage carries the beam parallel to itself."""
    places = [(25.0 * i, 25.0 * j) for j in (-1.5, -0.5, 0.5, 1.5) for i in (-2, -1, 0, 1, 2)]
    return [(dict.fromkeys(targets, place), place) for place in places]


def exposures(beams: list[Beam]) -> list[tuple[Places, tuple[float, float] | None]]:
    return [
        ({name: (x + sx * z, y + sy * z) for name, z in Z_MM.items()}, None)
        for x, y, sx, sy in beams
        for _ in range(EXPOSURES)
    ]


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unit's calibration, from a scan of two of its targets and another of the third, and its beams."""
    folder = tmp_path_factory.mktemp("three")
    scans = [
        write(folder / "scan-1", "scan", nodes("front", "rear")),
        write(folder / "scan-2", "scan", nodes("middle")),
    ]
    calibrated = altd_here("calibrate", *scans, "-o", folder / "cal.json")
    assert calibrated.status == 0, calibrated.err
    write(folder / "beams", "measurement", exposures(BEAMS))
    write(folder / "beam", "measurement", exposures(BEAMS[1:]))
    return folder


def check(document: dict[str, Any], beam: Beam) -> None:
    x, y, sx, sy = beam
    assert document["valid"], document
    assert (document["x_mm"], document["y_mm"]) == pytest.approx((x, y), abs=0.02)
    slopes = document["yaw_mm_per_m"], document["pitch_mm_per_m"]
    assert slopes == pytest.approx((1000 * sx, 1000 * sy), abs=0.1)
    for name, z_mm in Z_MM.items():
        place = document[name]["x_mm"], document[name]["y_mm"]
        assert place == pytest.approx((x + sx * z_mm, y + sy * z_mm), abs=0.03), name


def test_a_calibration_holds_them_in_the_beam_s_order(unit: Path) -> None:
    targets = json.loads((unit / "cal.json").read_text())["targets"]
    assert [(target["name"], target["z_mm"]) for target in targets] == list(Z_MM.items())


def test_a_replay_measures_one_line_through_all_of_them(unit: Path) -> None:
    windows = ("--window", EXPOSURES, "--every", EXPOSURES)
    replayed = altd_here("replay", unit / "beams", "--calibration", unit / "cal.json", *windows)
    assert replayed.status == 0, replayed.err
    for document, beam in zip(replayed.objects, BEAMS, strict=True):
        check(document, beam)


def test_one_target_alone_maps_and_is_no_beam(unit: Path, tmp_path: Path) -> None:
    alone = tmp_path / "middle.json"
    assert altd_here("calibrate", unit / "scan-2", "-o", alone).status == 0
    mapped = altd_here("map", "--calibration", alone, "--target", "middle", stdin="375 240\n")
    x_mm, y_mm, *_ = map(float, mapped.out.split())
    assert (x_mm, y_mm) == pytest.approx((0.0, 0.0), abs=0.02)
    refused = altd_here("replay", unit / "beams", "--calibration", alone)
    assert "target 'middle' alone" in refusal(refused)


def test_the_daemon_measures_and_publishes_all_of_them(unit: Path, tmp_path: Path) -> None:
    http, modbus = free_port(), free_port()
    targets = "".join(
        f'[[targets]]\nname = "{name}"\nz_mm = {z_mm}\ncamera = "{CAMERAS[name]}"\n'
        f'[cameras.{CAMERAS[name]}]\ndriver = "recording"\npath = "{unit / "beam"}"\nrepeat = true\n'
        for name, z_mm in Z_MM.items()
    )
    config = tmp_path / "altd.toml"
    config.write_text(
        f'[unit]\nserial = "THREE"\ncalibration = "{unit / "cal.json"}"\n{targets}'
        f'[measuring]\nwindow = {EXPOSURES}\n[http]\nhost = "127.0.0.1"\nport = {http}\n'
        f'[modbus_tcp]\nhost = "127.0.0.1"\nport = {modbus}\n'
    )
    command = [sys.executable, "-m", "altd.cli", "run", "--rehearsal", "--config", str(config)]
    with subprocess.Popen(command) as daemon:
        try:
            check(PlayingDaemon(daemon, http, modbus).wait_until_valid(), BEAMS[1])
            registers = polled(modbus, 20, 30)
        finally:
            daemon.kill()
    x_mm, y_mm = struct.unpack(">2f", struct.pack(">4H", *registers[:4]))
    assert (x_mm, y_mm) == pytest.approx(BEAMS[1][:2], abs=0.02)


def polled(port: int, first: int, count: int) -> list[int]:
    """Input registers, as mbpoll reads them."""
    command = [need_program("mbpoll", "mbpoll"), "-m", "tcp", "-p", str(port), "-t", "3:hex", "-0"]
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        shown = subprocess.run(
            [*command, "-r", str(first), "-c", str(count), "-1", "127.0.0.1"],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        words = [int(line.split()[1], 16) for line in shown.splitlines() if line.startswith("[")]
        if words[:2] != [0x7FC0, 0]:
            return words
    raise AssertionError("nothing valid on Modbus")
