"""``altd calibrate`` and ``altd replay`` on recordings of a plate that moves in its plane."""

import asyncio
import json
import math
import os
import shutil
import struct
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymodbus.client import ModbusTcpClient
from support.cli import altd_here, refusal
from support.opcua import read_by_node
from support.played_unit import PlayingDaemon
from support.ports import free_port

from altd.calibration.planar_file import load_planar_calibration
from altd.config import Measuring
from altd.instruments.planar.chain import PlanarChain
from altd.measuring.frame_chain import Provenance
from altd.reasons import Reason
from altd.records import CameraIdentity, Frame
from hw_sim.planar import Light, PlanarScene, Stay, known_and_unknown, places_mm, record

SEED = 31
KEYS = ("a_mm", "b_mm", "phi_deg")
ALL = tuple(range(7))


@pytest.fixture(scope="module")
def scene() -> PlanarScene:
    return PlanarScene(SEED)


@pytest.fixture(scope="module")
def known(scene: PlanarScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("planar") / "known"
    record(folder, scene, known_and_unknown(scene, scene.poses(6), [], None), 2, lambda done, planned: None)
    return folder


@pytest.fixture(scope="module")
def calibration(known: Path) -> Path:
    path = known.parent / "cal.json"
    done = altd_here("calibrate", known, "-o", path)
    assert done.status == 0
    assert "SIMULATED" in done.out
    assert "model: lens; 6 known poses" in done.out
    return path


def lines(folder: Path, calibration: Path, *options: str) -> list[dict[str, Any]]:
    done = altd_here("replay", folder, "--calibration", calibration, *options)
    assert done.status == 0, done.err
    return [json.loads(line) for line in done.out.splitlines()]


def test_leds_lost_one_by_one_and_windows_of_one_pose(
    scene: PlanarScene, calibration: Path, tmp_path: Path
) -> None:
    first, second = scene.poses(2)
    order = scene.shuffled_leds()
    stays = [Stay(pose, tuple(order[:count])) for pose in (first, second) for count in range(7, 0, -1)]
    record(tmp_path / "rec", scene, stays, 1, lambda done, planned: None)
    measured = lines(tmp_path / "rec", calibration, "--window", "4")
    assert [line["sequence"] for line in measured] == list(range(14))
    assert [line["frames"] for line in measured] == [1, 2, 3, 4, 4, 4, 0] * 2
    for line, stay in zip(measured, stays, strict=True):
        if len(stay.lit) == 1:
            assert (line["valid"], line["status"]) == (False, ["leds_missing", "simulated"])
            assert [line[key] for key in KEYS] == [None] * 3
            continue
        assert line["valid"], line["status"]
        for key, truth, limit in zip(KEYS, stay.pose, (0.03, 0.03, 0.02), strict=True):
            assert abs(line[key] - truth) < min(limit, 5 * line["sigma"][key])


def test_a_frozen_camera_gives_no_pose(scene: PlanarScene, calibration: Path, tmp_path: Path) -> None:
    a, b, phi = scene.poses(1)[0]
    stays = [Stay((a, b, phi), ALL), Stay((a + 5.0, b, phi), ALL)]
    record(tmp_path / "rec", scene, stays, 3, lambda done, planned: None)
    for number in (3, 4, 5):  # the plate moves, and the camera repeats what it saw
        shutil.copy(tmp_path / "rec/plate/000002.png", tmp_path / f"rec/plate/{number:06d}.png")
    measured = lines(tmp_path / "rec", calibration, "--window", "2")
    assert [line["valid"] for line in measured] == [True] * 3 + [False] * 3
    assert {line["status"][0] for line in measured[3:]} == {"frame_repeated"}


def test_a_move_of_a_motor_step_begins_a_window(
    scene: PlanarScene, calibration: Path, tmp_path: Path
) -> None:
    a, b, phi = scene.poses(1)[0]
    stays = [Stay((a, b, phi), ALL), Stay((a + 0.05, b, phi), ALL)]
    record(tmp_path / "rec", scene, stays, 4, lambda done, planned: None)
    measured = lines(tmp_path / "rec", calibration)
    assert [line["frames"] for line in measured] == [1, 2, 3, 4] * 2
    assert measured[-1]["a_mm"] - measured[3]["a_mm"] == pytest.approx(0.05, abs=0.01)


def test_lights_in_the_picture_are_left_out_or_refused(
    scene: PlanarScene, calibration: Path, tmp_path: Path
) -> None:
    pose = scene.poses(1)[0]
    x, y = (float(v) for v in places_mm(scene.leds_mm, pose)[0] + (17.0, 9.0))
    lit_by = (Light(x, y),), (Light(x, y, 7.0),), (Light(x, y),)
    lit = ALL[1:], ALL[1:], (0, 3)
    stays = [Stay(pose, leds, lights=lights) for leds, lights in zip(lit, lit_by, strict=True)]
    record(tmp_path / "rec", scene, stays, 1, lambda done, planned: None)
    reflection, lamp, of_two = lines(tmp_path / "rec", calibration, "--window", "1")
    for line in (reflection, lamp):
        assert line["valid"], line["status"]
        assert math.hypot(line["a_mm"] - pose[0], line["b_mm"] - pose[1]) < 0.03
    assert (of_two["valid"], of_two["status"][0]) == (False, "leds_misfit")


def spoilt(known: Path, folder: Path, column: int, value: str) -> Path:
    """A copy whose first known pose has another value in a column of the table."""
    shutil.copytree(known, folder)
    head, *rows = (folder / "frames.csv").read_text().splitlines()
    for at in (0, 1):
        fields = rows[at].split(",")
        fields[column] = value
        rows[at] = ",".join(fields)
    (folder / "frames.csv").write_text("\n".join([head, *rows]) + "\n")
    return folder


@pytest.mark.parametrize("error_mm", [1.0, 6.0, 30.0])
def test_a_known_pose_that_contradicts_the_others_is_named(
    known: Path, tmp_path: Path, error_mm: float
) -> None:
    b_mm = float((known / "frames.csv").read_text().splitlines()[1].split(",")[8])
    folder = spoilt(known, tmp_path / "rec", 8, f"{b_mm + error_mm}")
    said = refusal(altd_here("calibrate", folder, "-o", tmp_path / "cal.json"))
    assert f"{folder / 'frames.csv'}: row 2: a_mm, b_mm, phi_deg are " in said
    assert not (tmp_path / "cal.json").exists()


def test_a_pose_that_is_named_is_the_right_one_where_one_before_it_was_left_out(
    scene: PlanarScene, tmp_path: Path
) -> None:
    """At the second pose all lights are 3 mm from the LEDs, each elsewhere; the fifth is stated wrong."""
    stays = known_and_unknown(scene, scene.poses(8), [], None)
    turns = np.radians([0, 130, 250, 40, 170, 290, 80])
    scattered = places_mm(scene.leds_mm, stays[1].pose) + 3.0 * np.stack([np.cos(turns), np.sin(turns)], 1)
    stays[1] = replace(stays[1], lit=(), lights=tuple(Light(x, y) for x, y in scattered.tolist()))
    record(tmp_path / "rec", scene, stays, 1, lambda done, planned: None)
    right = altd_here("calibrate", tmp_path / "rec", "-o", tmp_path / "cal.json")
    assert (right.status, "model: lens; 7 known poses" in right.out) == (0, True), right
    a_mm, b_mm, phi_deg = stays[4].stated or stays[4].pose
    stays[4] = replace(stays[4], stated=(a_mm, b_mm + 1.0, phi_deg))
    record(tmp_path / "wrong", scene, stays, 1, lambda done, planned: None)
    said = refusal(altd_here("calibrate", tmp_path / "wrong", "-o", tmp_path / "wrong.json"))
    assert f"{tmp_path / 'wrong' / 'frames.csv'}: row 6: a_mm, b_mm, phi_deg are " in said


def test_wrong_files_are_refused(known: Path, calibration: Path, tmp_path: Path) -> None:
    unknown = tmp_path / "unknown"
    shutil.copytree(known, unknown)
    text = (unknown / "frames.csv").read_text().splitlines()
    (unknown / "frames.csv").write_text(
        "\n".join([text[0], *(r.rsplit(",", 3)[0] + ",,," for r in text[1:])])
    )
    assert "no row has a known pose" in refusal(altd_here("calibrate", unknown, "-o", tmp_path / "c.json"))
    assert "--flat: is not made" in refusal(
        altd_here("calibrate", known, "--flat", known, "-o", tmp_path / "c.json")
    )
    document = json.loads(calibration.read_text())
    document["disc_mm"] = 6.0
    (tmp_path / "edited.json").write_text(json.dumps(document))
    assert "checksum does not match" in refusal(
        altd_here("replay", known, "--calibration", tmp_path / "edited.json")
    )
    header = json.loads((unknown / "recording.json").read_text())
    header["unit"]["serial"] = "other"
    (unknown / "recording.json").write_text(json.dumps(header))
    assert "is for unit 'SIM-PLANAR-31'" in refusal(
        altd_here("replay", unknown, "--calibration", calibration)
    )


PLAYED = """
[unit]
serial = "SIM-PLANAR-31"
calibration = "cal.json"
instrument = "planar"
[measuring]
window = 4
[cameras.plate]
driver = "recording"
path = "moved"
repeat = true
"""


def test_the_daemon_measures_and_publishes_the_pose(
    scene: PlanarScene, calibration: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(calibration, tmp_path / "cal.json")
    a, b, phi = scene.poses(1)[0]
    stays = [Stay((a + step, b, phi), ALL) for step in (0.0, 3.0)]
    monkeypatch.setattr("hw_sim.planar.FPS", 5.0)  # a busy machine leaves out none of four in a row
    record(tmp_path / "moved", scene, stays, 12, lambda done, planned: None)
    port, modbus, opcua = free_port(), free_port(), free_port()
    config = tmp_path / "altd.toml"
    served = {"http": port, "modbus_tcp": modbus, "opcua": opcua}
    interfaces = (f'[{name}]\nhost = "127.0.0.1"\nport = {at}\n' for name, at in served.items())
    patient = "[measuring]\nsilent_after_s = 2\nstale_after_s = 10"
    config.write_text(PLAYED.replace("[measuring]", patient) + "".join(interfaces))
    checked = altd_here("check-config", config)
    assert (checked.status, "unit SIM-PLANAR-31, 1 camera" in checked.out) == (0, True), checked
    command = [sys.executable, "-m", "altd.cli", "run", "--rehearsal", "--config", str(config)]
    with subprocess.Popen(command, env={**os.environ, "PYTHONWARNINGS": "error"}) as process:
        daemon = PlayingDaemon(process, port, 0)
        try:
            for at in (a, a + 3.0):

                def is_there(now: dict[str, Any], at: float = at) -> bool:
                    return now["valid"] and now["frames"] == 4 and abs(now["a_mm"] - at) < 1.0

                measured = daemon.wait_until(is_there)
                for key, truth in zip(KEYS, (at, b, phi), strict=True):
                    assert abs(measured[key] - truth) < 5 * measured["sigma"][key]
            with ModbusTcpClient("127.0.0.1", port=modbus) as controller:
                words = controller.read_input_registers(0, count=120).registers
            floats = struct.unpack(">60f", struct.pack(">120H", *words))
            assert math.isnan(floats[10]), "x of a beam"
            for value, truth, sigma in zip(floats[54:57], (a, b, phi), floats[57:60], strict=True):
                assert min(abs(value - truth), abs(value - truth - 3.0)) < 5 * sigma
            keys = [*KEYS, *(f"{key}.sigma" for key in KEYS), "valid", "status"]
            read = asyncio.run(read_by_node(opcua, *keys))
            assert {read[key]["status"] for key in keys[:7]} == {"UncertainSimulatedValue"}
            assert {"playback", "simulated", "rehearsal"} >= set(read["status"]["value"]) >= {"rehearsal"}
            for key, truth in zip(KEYS, (a, b, phi), strict=True):
                error, sigma = abs(read[key]["value"] - truth), read[f"{key}.sigma"]["value"]
                assert min(error, abs(error - 3.0) if key == "a_mm" else error) < 5 * sigma
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/v1/calibration") as answer:
                assert set(json.load(answer)["expected_sigma"]) == set(KEYS)
        finally:
            process.terminate()
            assert process.wait(20) == 0


def test_a_plate_is_recorded_pose_by_pose_and_calibrated(scene: PlanarScene, tmp_path: Path) -> None:
    """``altd record --pose`` for each known pose, then all of them together."""
    plate = f"[plate]\nleds_mm = {scene.leds_mm.tolist()}\ndisc_mm = 5.0\n"
    config, recorded = tmp_path / "altd.toml", []
    for number, stay in enumerate(known_and_unknown(scene, scene.poses(6), [], None)):
        record(tmp_path / f"seen-{number}", scene, [stay], 2, lambda done, planned: None)
        played = PLAYED.replace('"moved"', f'"seen-{number}"\npace = "fast"').replace("repeat = true\n", "")
        config.write_text(plate + played)
        pose = ",".join(map(str, stay.stated or ()))
        recorded.append(tmp_path / f"pose-{number}")
        done = altd_here("record", "-o", recorded[-1], "--seconds", 1, f"--pose={pose}", "--config", config)
        assert done.status == 0, done
    calibrated = altd_here("calibrate", *recorded, "-o", tmp_path / "cal.json")
    assert "model: lens; 6 known poses" in calibrated.out, calibrated
    header = json.loads((recorded[3] / "recording.json").read_text())
    header["plate"]["leds_mm"][2][0] += 1.0
    (recorded[3] / "recording.json").write_text(json.dumps(header))
    said = refusal(altd_here("calibrate", *recorded, "-o", tmp_path / "other.json"))
    assert f"{recorded[3] / 'recording.json'}: plate: is not that of {recorded[0]}" in said
    done = altd_here(
        *("record", "-o", tmp_path / "driven", "--seconds", 1, "--joints=120,300.5,450", "--config", config)
    )
    head, first, *_ = (tmp_path / "driven/frames.csv").read_text().splitlines()
    assert (done.status, head.endswith(",a_mm,b_mm,phi_deg,joint_1_mm,joint_2_mm,joint_3_mm")) == (0, True)
    assert first.endswith(",,,,,,120.0,300.5,450.0")
    both = ("--pose=0,700,0", "--joints=1,2,3")
    said = refusal(altd_here("record", "-o", tmp_path / "x", "--seconds", 1, *both, "--config", config))
    assert "not allowed with" in said
    config.write_text(played)
    assert "no [plate] table" in refusal(
        altd_here("record", "-o", tmp_path / "x", "--seconds", 1, "--config", config)
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("window = 4", 'output = "now"', 'measuring.output: "now" is for a beam'),
        (
            "[cameras.plate]",
            "[cameras.other]\ndriver = 'recording'\npath = 'moved'\nrepeat = true\n[cameras.plate]",
            '"other", "plate" are too many',
        ),
        ("[measuring]", "[[targets]]\nname = 'a'\nz_mm = 0\ncamera = 'plate'\n[measuring]", "has no targets"),
        (
            "[measuring]",
            "[[serial]]\ndevice = '/dev/ttyS9'\nspeaks = 'telegram'\nsigma_now = true\n[measuring]",
            "serial.0.sigma_now: true is for a beam; possible: false",
        ),
        ("[measuring]", "[installation]\nsign_x = -1\n[measuring]", "installation: is for a beam"),
        (
            "[measuring]",
            "[plate]\nleds_mm = [[1, 2], [3, 4], [1, 2], [5, 5], [7, 8]]\n[measuring]",
            "plate.leds_mm: [1.0, 2.0] is already the place of leds_mm.0",
        ),
        ('"planar"', '"beam"', "targets: 0 tables [[targets]]; possible: 2 or more"),
    ],
)
def test_a_config_for_another_instrument_is_refused(
    calibration: Path, tmp_path: Path, old: str, new: str, said: str
) -> None:
    config = tmp_path / "altd.toml"
    config.write_text(PLAYED.replace(old, new))
    refused = altd_here("check-config", config)
    assert (refused.status, said in refused.err) == (2, True), refused.err


class TestLive:
    """The chain as the daemon drives it, with the frames that a camera may deliver."""

    @pytest.fixture
    def chain(self, calibration: Path) -> PlanarChain:
        of = Provenance(identity=lambda camera: self.camera)
        return PlanarChain("plate", load_planar_calibration(calibration), Measuring(window=4), of)

    camera = CameraIdentity("1", "cam", "aravis")

    def frames(self, scene: PlanarScene, *lit: tuple[int, ...]) -> Iterator[Frame]:
        pose = scene.poses(1)[0]
        for number, leds in enumerate(lit):
            pixels = scene.expose(scene.mean_electrons(pose, leds))
            yield Frame("plate", number, number * 50_000_000, pixels)

    def test_after_a_pause_no_earlier_frame_counts(self, scene: PlanarScene, chain: PlanarChain) -> None:
        one, two, three = self.frames(scene, ALL, ALL, (0, 3))
        chain.push(one)
        (paused, later) = (replace(two, t_ns=two.t_ns + 10**9), replace(three, t_ns=three.t_ns + 10**9))
        anew = replace(later, sequence=0, t_ns=later.t_ns + 50_000_000)
        seen = [one for frame in (paused, later, anew) for one in chain.push(frame)]
        assert [one.frames for one in seen] == [1, 2, 0], "two LEDs alone are not followed"
        silent = chain.silence(3 * 10**9)
        assert silent.sequence == 0
        assert silent.status[0].reason is Reason.CAMERA_SILENT

    def test_two_leds_are_not_followed_across_a_pause(self, chain: PlanarChain) -> None:
        """The plate may have turned by half a turn meanwhile; its two LEDs look the same then."""
        scene = PlanarScene(SEED)
        a, b, phi = scene.poses(1)[0]
        turned = scene.mean_electrons((a, b, phi + 180.0), ALL)
        (first, second) = (
            scene.expose(scene.mean_electrons((a, b, phi + 180.0), of)) for of in (ALL, (0, 3))
        )
        assert turned is not None
        [measured] = chain.push(Frame("plate", 0, 0, first))
        assert measured.valid
        [followed] = chain.push(Frame("plate", 1, 50_000_000, second))
        assert followed.valid
        again = scene.expose(scene.mean_electrons((a, b, phi + 180.0), (0, 3)))
        [after] = chain.push(Frame("plate", 2, 10**9, again))
        assert not after.valid or abs(after.values["phi_deg"].value - measured.values["phi_deg"].value) > 90.0

    def test_another_camera_and_a_changing_exposure_give_no_pose(
        self, scene: PlanarScene, calibration: Path
    ) -> None:
        known = replace(load_planar_calibration(calibration), camera=CameraIdentity("1", "cam", "aravis"))
        of = Provenance(identity=lambda camera: self.camera)
        chain = PlanarChain("plate", known, Measuring(), of)
        same, other, changing = self.frames(scene, ALL, ALL, ALL)
        seen = chain.push(same)
        self.camera = CameraIdentity("2", "cam", "aravis")
        seen += chain.push(other)
        self.camera = CameraIdentity("1", "cam", "aravis")
        seen += chain.push(replace(changing, changing=True))
        assert [(one.valid, str(one.status[0].reason)) for one in seen] == [
            (True, "simulated"),
            (False, "wrong_camera"),
            (False, "exposure_changing"),
        ]
