"""``altd selfcheck RECORDING`` on a simulated unit that has changed since its calibration."""

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.cli import altd_here

from hw_sim.beam import BeamPose
from hw_sim.displacement import Displacement
from hw_sim.recording import recording
from hw_sim.targets import LED_POSITIONS_MM
from hw_sim.unit import CAMERAS, Unit, UnitConfig

POSE = BeamPose(20.0, 10.0, 0.05, -0.03)
ALUMINIUM_PER_K, WARMER_K = 23.6e-6, 50.0


def record(folder: Path, change: Callable[[Unit], object] = lambda unit: None, **config: Any) -> Path:
    """A self-check of the unit with seed 3 in bright surroundings, in a folder of its own."""
    unit = Unit(UnitConfig(seed=3, lux=1000.0, **config))
    change(unit)
    with recording(folder / "check", unit, "self-check", 8, lambda done, planned: None) as recorder:
        for leds_on in (False, True) * 4:
            recorder.expose(POSE, leds_on=leds_on)
    return folder / "check"


def judged(checked: Path, unit: Path) -> tuple[int, dict[str, Any]]:
    said = altd_here("selfcheck", checked, "--calibration", unit / "cal.json", "--json")
    assert said.status in (0, 1), said.err
    (document,) = said.objects
    return said.status, document


def test_a_unit_that_stands_as_it_was_calibrated_is_good(unit_3: Path, tmp_path: Path) -> None:
    status, said = judged(record(tmp_path), unit_3)
    assert (status, said["verdict"], said["reasons"]) == (0, "good", [])
    assert said["origin"] == "simulated"
    assert {part["of"]: part["verdict"] for part in said["parts"]} == dict.fromkeys(
        ("front", "rear", "yaw, pitch"), "good"
    )
    for target in said["targets"].values():
        assert (target["leds_expected"], target["leds_found"]) == (6, 6)
        assert target["shift_px"] == pytest.approx([0, 0], abs=0.015)
        assert target["significance"] < 6
        assert target["rms_px"] < 0.02


def test_a_camera_that_moved_is_told_with_what_that_does_to_a_measurement(
    unit_3: Path, tmp_path: Path
) -> None:
    moved = Displacement((0.3, -0.2), 0.05, 100.0)
    status, said = judged(record(tmp_path, lambda unit: unit.displace("front", moved)), unit_3)
    assert status == 1
    assert said["verdict"] in ("suspect", "bad")
    worst = said["parts"][0]
    assert (worst["of"], worst["unit"], worst["suspect"], worst["bad"]) == ("front", "mm", 0.03, 0.1)
    assert worst["error"] >= max(abs(said["x_mm"]), abs(said["y_mm"])) > worst["suspect"]
    lens = Unit(UnitConfig(seed=3)).imagers["front"].view.lens
    leds = np.array(LED_POSITIONS_MM)
    before, after = (np.stack(each.project(*leds.T), axis=1) for each in (lens, moved.of(lens)))
    front = said["targets"]["front"]
    assert front["shift_px"] == pytest.approx((after - before).mean(axis=0), abs=0.015)
    assert front["turn_deg"] == pytest.approx(0.05, abs=0.003)
    assert front["scale_ppm"] == pytest.approx(100.0, abs=50.0)
    x_mm, y_mm = lens.unproject(*moved.of(lens).project(POSE.x_mm, POSE.y_mm))
    expected = {"x_mm": float(x_mm) - POSE.x_mm, "y_mm": float(y_mm) - POSE.y_mm}
    for place, angle, slope in (("x_mm", "yaw_deg", POSE.slope_x), ("y_mm", "pitch_deg", POSE.slope_y)):
        off = expected[place]
        turned = math.degrees(math.atan(slope - off / 280.0) - math.atan(slope))
        assert said[place] == pytest.approx(off, abs=4 * said["sigma"][place] + 0.002)
        assert said[angle] == pytest.approx(turned, abs=4 * said["sigma"][angle] + 0.0005)


def test_targets_that_went_apart_are_not_seen_by_leds_in_their_own_frames(
    unit_3: Path, tmp_path: Path
) -> None:
    """Fig. 3.17: 50 K lengthen 280 mm of aluminium by 0.330 mm and a slope of 250 mm/m by 0.0159°.

    Each camera is still where it was relative to its own target: the LEDs rightly give the verdict good.
    """
    expansion = ALUMINIUM_PER_K * WARMER_K
    assert 280.0 * expansion == pytest.approx(0.330, abs=0.001)
    error_deg = math.degrees(math.atan(0.25 * (1 + expansion)) - math.atan(0.25))
    assert error_deg == pytest.approx(0.0159, abs=0.0001)
    status, said = judged(record(tmp_path, expansion=expansion), unit_3)
    assert (status, said["verdict"]) == (0, "good")
    for key in ("yaw_deg", "pitch_deg"):
        assert abs(said[key]) < 0.1 * error_deg


def test_a_camera_whose_distance_to_its_target_grew_is_seen_by_its_scale(
    unit_3: Path, tmp_path: Path
) -> None:
    """The aluminium also holds the cameras: farther by 1180 ppm, each sees its LEDs smaller by that."""
    scale_ppm = 1e6 * (1 / (1 + ALUMINIUM_PER_K * WARMER_K) - 1)

    def warm(unit: Unit) -> None:
        for camera in CAMERAS:
            unit.displace(camera, Displacement(scale_ppm=scale_ppm))

    status, said = judged(record(tmp_path, warm, expansion=ALUMINIUM_PER_K * WARMER_K), unit_3)
    assert status == 1
    for target in said["targets"].values():
        assert target["scale_ppm"] == pytest.approx(scale_ppm, abs=60)
        assert target["significance"] > 20


def test_the_led_pairs_of_a_foreign_units_own_scan_are_good(shared_data: Path, unit_a: Path) -> None:
    said = altd_here("selfcheck", shared_data / "unit-a" / "scan", "--calibration", unit_a / "cal.json")
    lines = said.out.splitlines()
    assert said.status == 0
    assert lines[-2:] == ["verdict  good: nothing to do", "  - front: LED 4: cut"]
    assert lines[1].split() == ["LEDs", "front", "good", ">=", "3", "5", "of", "6", "used,", "1", "cut"]


def test_what_is_no_self_check_is_refused_in_one_line(unit_3: Path, tmp_path: Path) -> None:
    checked = record(tmp_path)
    header = json.loads((checked / "recording.json").read_text())
    table = (checked / "frames.csv").read_text()

    def refusal(change: Callable[[Path], object]) -> str:
        folder = tmp_path / "changed"
        shutil.copytree(checked, folder)
        change(folder)
        said = altd_here("selfcheck", folder, "--calibration", unit_3 / "cal.json")
        shutil.rmtree(folder)
        assert said.status == 2
        assert said.out == ""
        (line,) = said.err.splitlines()
        return line

    def headed(**keys: object) -> Callable[[Path], object]:
        return lambda folder: (folder / "recording.json").write_text(json.dumps({**header, **keys}))

    needs = "is of kind 'flat'; a self-check needs one of: self-check, measurement, scan"
    assert needs in refusal(headed(kind="flat"))
    assert "kind: 'view' is not possible; possible: scan, plate, flat" in refusal(headed(kind="view"))
    assert "SIM-3" in refusal(headed(unit={"serial": "OTHER", "target_distance_mm": 280.0}))
    assert "LEDs on and off" in refusal(
        lambda folder: (folder / "frames.csv").write_text(table.replace(",on,", ",off,"))
    )
    assert "front/000003.png" in refusal(lambda folder: (folder / "front/000003.png").unlink())
    missing = altd_here("selfcheck", checked, "--calibration", tmp_path / "nothing.json")
    assert missing.status == 2
