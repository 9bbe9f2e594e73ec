"""``altd calibrate`` and ``altd replay`` on recordings of a plate that moves in its plane."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.cli import altd_here, refusal

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
    assert "checksum does not fit" in refusal(
        altd_here("replay", known, "--calibration", tmp_path / "edited.json")
    )
    header = json.loads((unknown / "recording.json").read_text())
    header["unit"]["serial"] = "other"
    (unknown / "recording.json").write_text(json.dumps(header))
    assert "is for unit 'SIM-PLANAR-31'" in refusal(
        altd_here("replay", unknown, "--calibration", calibration)
    )
