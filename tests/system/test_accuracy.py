"""The unit against truth that it does not know: a foreign recording, and simulated units."""

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.cli import altd_here

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


@pytest.mark.parametrize("seed", [1, 2])
def test_a_simulated_unit(seed: int, simulated_unit: Callable[[int], Path], tmp_path: Path) -> None:
    poses, truth = tmp_path / "poses", tmp_path / "truth.json"
    arguments = ("measure", "-o", poses, "--truth", truth, "--poses", 30, "--exposures", 4, "--seed", seed)
    outcome = altd_here(*arguments, module="hw_sim")
    assert outcome.status == 0, outcome.err
    lines = measure(simulated_unit(seed) / "cal.json", poses)
    check(*errors_and_sigmas(lines, json.loads(truth.read_text())["poses"]))
