"""The unit against truth that it does not know: a foreign recording, and simulated units."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.cli import altd_here
from support.made_once import made_once

from altd.app.replay import replay_of
from altd.calibration.calibrating import calibrate
from altd.calibration.file import save_calibration
from altd.recording.reader import open_recording

QUANTITIES = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")


def measure(calibration: Path, poses: Path, exposures: int = 4) -> list[dict[str, Any]]:
    replayed = altd_here(
        "replay", poses, "--calibration", calibration, "--window", exposures, "--every", exposures
    )
    assert replayed.status == 0, replayed.err
    return replayed.objects


def errors_and_sigmas(
    lines: Sequence[dict[str, Any]], truth: Sequence[dict[str, float]]
) -> tuple[np.ndarray, np.ndarray]:
    """Both (poses, 4): x mm, y mm, yaw deg, pitch deg."""
    assert len(lines) == len(truth)
    assert all(line["valid"] for line in lines)
    expected = [
        (
            pose["x_mm"],
            pose["y_mm"],
            math.degrees(math.atan(pose["slope_x"])),
            math.degrees(math.atan(pose["slope_y"])),
        )
        for pose in truth
    ]
    measured = np.array([[line[name] for name in QUANTITIES] for line in lines])
    sigmas = np.array([[line["sigma"][name] for name in QUANTITIES] for line in lines])
    return measured - np.array(expected), sigmas


def check(errors: np.ndarray, sigmas: np.ndarray) -> None:
    """The figures that issue 2 demands."""
    rms = np.sqrt(np.mean(errors**2, axis=0))
    assert (rms[:2] <= 0.014).all(), rms
    assert (rms[2:] <= 0.004).all(), rms
    assert np.abs(errors[:, :2]).max() <= 0.03
    assert np.abs(errors[:, 2:]).max() <= 0.010
    assert 0.7 <= np.sqrt(np.mean((errors / sigmas) ** 2)) <= 1.4


def test_a_unit_that_this_project_did_not_make(shared_data: Path, unit_a: Path) -> None:
    lines = measure(unit_a / "cal.json", shared_data / "unit-a" / "poses")
    truth = json.loads((shared_data / "unit-a" / "poses.truth.json").read_text())
    check(*errors_and_sigmas(lines, truth["poses"]))


def test_a_vibration_at_the_frame_rate_is_in_sigma_where_it_is_stated_or_the_frames_are_uneven(
    shared_data: Path,
) -> None:
    """Of about 0.3 mm at 20 Hz, drawn by a foreign program: unstated and even it errs by up to 16 sigma."""
    folder = shared_data / "unit-b"

    def make(made: Path) -> None:
        save_calibration(calibrate([open_recording(folder / "scan")]).calibration, made / "cal.json")

    calibration = made_once("unit-b", make, folder / "scan") / "cal.json"
    for recording, stated_mm, is_covered in (
        ("vibration-20hz", 0.0, False),
        ("vibration-20hz", 0.3, True),
        ("vibration-20hz-delayed", 0.0, True),
    ):
        replay = replay_of(open_recording(folder / recording), calibration, 20, 20)
        measuring = replay.measuring.model_copy(update={"vibration_mm": stated_mm})
        replay = replace(replay, measuring=measuring)
        lines = [dict(replay.as_object(measurement)) for measurement in replay.measurements()]
        truth = json.loads((folder / f"{recording}.truth.json").read_text())["poses"]
        poses = [{**pose, "x_mm": pose["x"], "y_mm": pose["y"]} for pose in truth]
        errors, sigmas = errors_and_sigmas(lines, poses)
        assert (np.abs(errors / sigmas).max() < 3.5) == is_covered, (recording, stated_mm)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_simulated_unit(seed: int, simulated_unit: Callable[[int], Path], tmp_path: Path) -> None:
    poses, truth = tmp_path / "poses", tmp_path / "truth.json"
    arguments = ("measure", "-o", poses, "--truth", truth, "--poses", 30, "--exposures", 4, "--seed", seed)
    outcome = altd_here(*arguments, module="hw_sim")
    assert outcome.status == 0, outcome.err
    lines = measure(simulated_unit(seed) / "cal.json", poses)
    check(*errors_and_sigmas(lines, json.loads(truth.read_text())["poses"]))
