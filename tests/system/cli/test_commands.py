import csv
import json
import os
import shutil
import socket
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.cli import altd, altd_here, refusal
from support.frames import frame
from support.plates import FRONT, REAR, plate_light, write_plate
from support.recordings import write, write_beams, write_scan
from support.unit_toml import TARGETS, write_config

from altd.calibration.file import load_calibration

BEAMS = [(10.0, 5.0, 0.02, -0.03), (-30.0, 20.0, -0.05, 0.04), (0.0, -12.5, 0.1, 0.05)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scan, its calibration, a measurement and a config that plays it."""
    path = tmp_path_factory.mktemp("unit")
    write_scan(path / "scan")
    write_beams(path / "beams", BEAMS)
    outcome = altd_here("calibrate", path / "scan", "-o", path / "cal.json")
    assert outcome.status == 0, outcome.err
    assert outcome.err == ""
    assert "\nfront   " in outcome.out
    assert "\nrear: plain, no print" in outcome.out
    assert "\nrear: profile and ellipse lie 0.0" in outcome.out
    write_config(path / "altd.toml", path / "cal.json", path / "beams")
    return path


def back_to_back(calibration: Path) -> tuple[object, ...]:
    return "--calibration", calibration, "--window", 4, "--every", 4


def test_a_calibrated_unit_measures_its_beams(folder: Path) -> None:
    outcome = altd_here("replay", folder / "beams", *back_to_back(folder / "cal.json"))
    assert (outcome.status, outcome.err) == (0, "")
    assert len(outcome.objects) == len(BEAMS)
    for number, (line, (x, y, slope_x, slope_y)) in enumerate(zip(outcome.objects, BEAMS, strict=True)):
        assert line["valid"]
        assert (line["sequence"], line["frames"], line["status"]) == (4 * number + 3, 4, [])
        assert line["t_s"] == pytest.approx((4 * number + 1.5) / 20)  # the middle of the exposures
        assert line["time"] is None  # the recording does not know it
        assert line["roll_deg"] is None
        assert (line["x_mm"], line["y_mm"]) == pytest.approx((x, y), abs=0.03)
        assert line["yaw_mm_per_m"] == pytest.approx(1000 * slope_x, abs=0.15)
        assert line["pitch_mm_per_m"] == pytest.approx(1000 * slope_y, abs=0.15)
        assert line["rear"]["x_mm"] == pytest.approx(x + 280 * slope_x, abs=0.03)
        assert 0 < line["sigma"]["x_mm"] < 0.03


def test_the_sliding_mean_gives_a_line_after_every_exposure(folder: Path) -> None:
    outcome = altd_here("replay", folder / "beams", "--calibration", folder / "cal.json", "--window", 4)
    assert [line["sequence"] for line in outcome.objects] == list(range(12))
    assert outcome.objects[0]["status"] == ["warming_up"]
    assert outcome.objects[5]["status"] == ["unsteady"]  # half the window before, half after the beam moved
    assert [outcome.objects[n]["valid"] for n in (3, 7, 11)] == [True] * 3


def test_frames_that_stood_still_when_they_were_recorded_are_said_to(folder: Path, tmp_path: Path) -> None:
    rec = shutil.copytree(folder / "beams", tmp_path / "rec")
    for number in (5, 6, 7, 8):
        shutil.copy(rec / "rear0004.png", rec / f"rear{number:04d}.png")
    outcome = altd_here("replay", rec, "--calibration", folder / "cal.json", "--window", 4)
    assert (outcome.status, outcome.err) == (0, "")
    still = [n for n, line in enumerate(outcome.objects) if line["status"] == ["rear_frame_repeated"]]
    assert still == [6, 7, 8, 9]  # and until half a window is new
    assert [line["valid"] for line in outcome.objects[6:]] == [False] * 4 + [True] * 2


def test_a_start_time_in_the_recording_gives_utc(folder: Path, tmp_path: Path) -> None:
    beam = (10.0, 5.0)
    rec = write(tmp_path / "rec", "measurement", [(beam, beam, None)] * 2, start="2026-11-20T08:15:30Z")
    outcome = altd_here("replay", rec, "--calibration", folder / "cal.json", "--window", 2, "--every", 2)
    assert outcome.objects[0]["time"] == "2026-11-20T08:15:30.025Z"


def pictures(recording: Path, camera: str) -> list[bytes]:
    rows = csv.DictReader((recording / "frames.csv").read_text().splitlines())
    files = [recording / row["file"] for row in rows if row["camera"] == camera]
    return [cv2.imread(file, cv2.IMREAD_UNCHANGED).tobytes() for file in files]


def test_record_keeps_what_the_cameras_deliver(folder: Path, tmp_path: Path) -> None:
    outcome = altd_here(
        "record", "--config", folder / "altd.toml", "-o", tmp_path / "kept", "--seconds", "0.5"
    )
    assert outcome.status == 0, outcome.err
    for camera in ("front", "rear"):
        original, kept = pictures(folder / "beams", camera), pictures(tmp_path / "kept", camera)
        places = [original.index(picture) for picture in kept]
        rows = csv.DictReader((tmp_path / "kept" / "frames.csv").read_text().splitlines())
        numbers = [int(row["sequence"]) for row in rows if row["camera"] == camera]
        # One that a busy machine drops is missing in the numbers, too: no picture has another's number.
        assert [place - places[0] for place in places] == [number - numbers[0] for number in numbers]
    replayed = altd_here("replay", tmp_path / "kept", "--calibration", folder / "cal.json", "--window", 1)
    assert len(replayed.objects) == len(kept)
    assert replayed.objects[0]["time"].endswith("Z")
    header = json.loads((tmp_path / "kept" / "recording.json").read_text())
    assert header["note"] == "altd record, playback"
    assert header["targets"] == list(TARGETS)
    assert header["unit"] == {"serial": "TEST-1", "target_distance_mm": 280.0}
    assert "not an empty folder" in refusal(
        altd_here("record", "--config", folder / "altd.toml", "-o", tmp_path / "kept", "--seconds", "0.5")
    )


def test_a_flat_that_was_recorded_with_the_unit_goes_into_its_calibration(
    folder: Path, tmp_path: Path
) -> None:
    lit = frame(np.full((480, 752), 100.0), np.random.default_rng(1)).pixels
    screen = write_beams(tmp_path / "screen", BEAMS[:1])
    for path in screen.glob("*.png"):
        cv2.imwrite(str(path), lit)
    config = write_config(tmp_path / "altd.toml", folder / "cal.json", screen)
    flat, output = tmp_path / "flat", tmp_path / "cal.json"
    outcome = altd_here("record", "--config", config, "-o", flat, "--seconds", "0.2", "--kind", "flat")
    assert outcome.status == 0, outcome.err
    assert json.loads((flat / "recording.json").read_text())["kind"] == "flat"
    outcome = altd_here("calibrate", folder / "scan", "--flat", flat, "-o", output)
    assert outcome.status == 0, outcome.err
    assert "\nrear: localised through its recorded flat" in outcome.out
    assert [target.flat is not None for target in load_calibration(output).targets] == [True, True]
    lines = altd_here("replay", folder / "beams", *back_to_back(output)).objects
    assert [line["valid"] for line in lines] == [True] * len(BEAMS)


def test_a_plate_whose_leds_are_switched_by_hand_is_recorded_and_calibrated(
    folder: Path, tmp_path: Path
) -> None:
    shown = write_plate(tmp_path / "plate", plate_light(FRONT), plate_light(REAR), pairs=6)
    table = (shown / "frames.csv").read_text().splitlines()
    dark, lit = ([line for line in table[1:] if f",{leds}," in line] for leds in ("off", "on"))
    rows = [
        f"{number // 2},{number // 2 / 20:.6f},{line.split(',', 2)[2].replace(',on,', ',off,')}"
        for number, line in enumerate(dark + lit)
    ]
    (shown / "frames.csv").write_text("\n".join((table[0], *rows)) + "\n")
    config = write_config(tmp_path / "altd.toml", folder / "cal.json", shown)
    config.write_text(config.read_text().replace("repeat = true", 'pace = "fast"'))
    kept, output = tmp_path / "kept", tmp_path / "new.json"
    record = ("record", "--config", config, "-o", kept, "--seconds", "60", "--kind", "plate")
    assert "altd record: --plate: C,R,MM must follow `--kind plate`" in refusal(altd_here(*record))
    assert "--plate: requires `--kind plate`" in refusal(altd_here(*record[:-1], "flat", "--plate", "7,5,25"))
    assert "--beam: requires `--kind plate`" in refusal(altd_here(*record[:-1], "flat", "--beam", "5.5"))
    outcome = altd_here(*record, "--plate", "7,5,25", "--beam", "5.5")
    assert outcome.status == 0, outcome.err
    assert json.loads((kept / "recording.json").read_text())["plate"] == {
        "columns": 7,
        "rows": 5,
        "pitch_mm": 25.0,
        "origin_mm": [-75.0, -50.0],
        "beam_mm": 5.5,
    }
    assert ",on," not in (kept / "frames.csv").read_text()
    outcome = altd_here("calibrate", kept, "-o", output)
    assert outcome.status == 0, outcome.err
    assert outcome.err == ""
    assert [target.name for target in load_calibration(output).targets] == ["front", "rear"]
    screen = (*record[:5], "--seconds", "60", "--kind", "plate", "--plate", "7,5,25,0.05")
    for option, value, why in (
        ("--target", "back", "there is no 'back'; possible: front, rear"),
        ("--placed", "0.5,0.5,10", "needs MM and DEG from 0, CAMERA_MM from 20"),
        ("--shift", "25,0", "must be less than the pitch, 25 mm"),
    ):
        refused = altd_here(*screen[:4], tmp_path / "none", *screen[5:], option, value)
        assert f"altd record: {option}: {why}" in refusal(refused)
    config.write_text(config.read_text().replace("[unit]", '[unit]\nkind = "desk"'))
    unstated = refusal(altd_here(*screen[:4], tmp_path / "none", *screen[5:]))
    assert "altd record: --plate: of a unit on a desk requires C,R,MM,SIGMA_MM and --placed" in unstated
    for name in ("front", "rear"):
        on_one = (*screen[:4], tmp_path / name, *screen[5:], "--target", name, "--placed", "0.5,0.5,350")
        outcome = altd_here(*on_one)
        assert outcome.status == 0, outcome.err
    outcome = altd_here("calibrate", tmp_path / "front", tmp_path / "rear", "-o", output)
    assert (outcome.status, outcome.err) == (0, "")
    of_screens = load_calibration(output)
    assert [target.name for target in of_screens.targets] == ["front", "rear"]
    assert of_screens.limits.stage_scale_ppm == pytest.approx(1e6 * np.hypot(0.05 / 25, 1 / 350))
    zero_mm_per_m = 1e3 * np.sqrt(2) * 0.5 / of_screens.targets[1].z_mm
    assert of_screens.limits.beam_normal_mm_per_m == pytest.approx(zero_mm_per_m)
    outcome = altd_here(*screen[:4], tmp_path / "moved", *on_one[5:], "--shift=-6.25,12.5")
    assert outcome.status == 0, outcome.err
    moved = json.loads((tmp_path / "moved" / "recording.json").read_text())
    assert moved["plate"]["origin_mm"] == [-75.0 - 6.25, -50.0 + 12.5]
    assert [target["name"] for target in moved["targets"]] == ["rear"]


EXPANSION = """[[thermometers]]
driver = "hwmon"
name = "frame"
chip = "tmp102"

[installation]
thermometer = "frame"
expansion = { distance_ppm_per_k = 23.6 }

[measuring]"""


class TestBadInput:
    """One clear line on stderr that names file and place, exit status 2, no output, nothing half written."""

    def replay(self, folder: Path, recording: Path, calibration: str = "cal.json") -> str:
        return refusal(altd_here("replay", recording, "--calibration", folder / calibration))

    def test_config_that_is_wrong(self, folder: Path, tmp_path: Path) -> None:
        good = (folder / "altd.toml").read_text()
        for old, new, message in (
            ('serial = "TEST-1"', 'serial = "TEST-1"\nnumber = 1', "unit.number: there is no such key"),
            ("window = 4", 'window = "four"', 'measuring.window: "four" is not a whole number'),
            ("z_mm = 280.0", "z_mm = 281.0", "target 'rear' was calibrated at z 280 mm, not 281"),
            (
                "z_mm = 0.0",
                "z_mm = 0.0\nglass_mm = 4.0",
                "target 'front' was calibrated without glass behind it, not with 4 mm of glass (index 1.52)",
            ),
            (
                "[measuring]",
                EXPANSION,
                "temperature_c is not stated, and [installation.expansion] corrects from it",
            ),
            ('serial = "TEST-1"', 'serial = "OTHER"', "is for unit 'TEST-1', this is unit 'OTHER'"),
            ('"front"\nz_mm', '"middle"\nz_mm', "does not know target 'middle'"),
        ):
            path = tmp_path / "altd.toml"
            path.write_text(good.replace(old, new))
            for command in (("run", "--config", path), ("check-config", path)):
                assert message in refusal(altd_here(*command)), command
        assert "No such file" in refusal(altd_here("run", "--config", tmp_path / "none.toml"))

    def test_a_file_that_is_not_there_yet_is_told_and_no_fault_of_the_config(
        self, folder: Path, tmp_path: Path
    ) -> None:
        """Findings beside the config depend on the computer; `altd doctor` calls them wrong."""
        path = tmp_path / "altd.toml"
        path.write_text((folder / "altd.toml").read_text().replace(str(folder / "beams"), "nowhere"))
        assert "/nowhere does not exist yet; altd record makes it" in refusal(
            altd_here("run", "--config", path)
        )
        outcome = altd_here("check-config", path)
        assert (outcome.status, outcome.err) == (0, "")
        assert outcome.out.splitlines() == [
            f"{path}: good: unit TEST-1, 2 targets",
            f"{path}: not live: its values are valid only with `altd run --rehearsal`",
            f"{path}: cameras.front.path, cameras.rear.path: {tmp_path}/nowhere does not exist yet; "
            "altd record makes it",
        ]

    @pytest.mark.parametrize("face", ["modbus_tcp", "http"])
    def test_a_port_in_use(self, folder: Path, tmp_path: Path, face: str) -> None:
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            more = f'[{face}]\nhost = "127.0.0.1"\nport = {port}\n'
            config = write_config(tmp_path / "altd.toml", folder / "cal.json", folder / "beams", more)
            outcome = altd("check-config", config)
            said = f"{config}: {face} 127.0.0.1:{port}: python (process {os.getpid()}) listens there: end it"
            assert (outcome.status, said in outcome.out) == (0, True), outcome

    def test_a_target_that_is_none(self, folder: Path) -> None:
        arguments = ("map", "--calibration", folder / "cal.json", "--target", "side")
        assert "does not know target 'side', only 'front', 'rear'" in refusal(altd_here(*arguments, stdin=""))
