"""The examples for points of the machine, against vectors whose truth is geometry in a world of its own."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.foreign import need_program
from support.measurements import measured
from support.places import ROOT
from support.structured_text import Library
from support.world import World

from altd.config import Installation, Machine
from altd.instruments.beam.points import MachinePoints
from altd.instruments.beam.solver import Beam
from altd.records.joint import Joint

VECTORS = ROOT / "docs" / "machine-vectors.json"
EXAMPLES = ROOT / "examples"
CASES: list[dict[str, Any]] = json.loads(VECTORS.read_text())
NUMBERS = ("right_mm", "up_mm", "sigma_right_mm", "sigma_up_mm")


def made() -> list[dict[str, Any]]:
    """Twelve beams, units and points at random, and the first as simple as can be checked by hand."""
    rng, cases = np.random.default_rng(64), []
    for number in range(12):
        root = np.tril(rng.normal(0.0, 1.0, (4, 4))) * [[0.01], [0.01], [0.05], [0.05]]
        beam = rng.uniform(-1.0, 1.0, 4) * (60.0, 45.0, 110.0, 250.0)
        lever, roll_deg = rng.uniform(-1.0, 1.0, 3) * (2000.0, 2000.0, 9000.0), rng.uniform(-8.0, 8.0)
        inclination, sigma_roll_deg, sigma_lever_mm = rng.uniform(-60.0, 60.0), 0.02, 0.5
        if number == 0:
            beam, lever = np.array([10.0, 5.0, 20.0, 0.0]), np.array([0.0, 0.0, 1000.0])
            roll_deg, inclination, root = 0.0, 0.0, np.diag([0.01, 0.01, 0.05, 0.05])
        given = {
            "beam": np.round(beam, 4).tolist(),
            "covariance": (root @ root.T).tolist(),
            "roll_deg": round(roll_deg, 4),
            "sigma_roll_deg": sigma_roll_deg,
            "inclination_mm_per_m": round(inclination, 3),
            "lever_mm": np.round(lever, 2).tolist(),
            "sigma_lever_mm": sigma_lever_mm,
        }
        found = np.concatenate(expected(given))
        cases.append({"given": given, "expected": dict(zip(NUMBERS, found.round(5).tolist(), strict=True))})
    return cases


def expected(given: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Distances in the world, and their standard uncertainties by differences of worlds."""
    lever, inclination = np.array([given["lever_mm"]]), given["inclination_mm_per_m"]

    def distances(numbers: np.ndarray) -> np.ndarray:
        return World.of(numbers[:4], numbers[4], inclination).distances(lever)[0]

    at = np.array([*given["beam"], given["roll_deg"]])
    slopes = [(distances(at + step) - distances(at - step)) / (2 * step.max()) for step in 0.01 * np.eye(5)]
    by = np.array(slopes).T
    of_beam = np.einsum("ij,jk,ik->i", by[:, :4], np.array(given["covariance"]), by[:, :4])
    of_roll = (by[:, 4] * given["sigma_roll_deg"]) ** 2
    return distances(at), np.sqrt(of_beam + of_roll + given["sigma_lever_mm"] ** 2)


def test_the_vectors_are_those_of_the_world() -> None:
    for case, wanted in zip(CASES, made(), strict=True):
        assert case["given"]["lever_mm"] == wanted["given"]["lever_mm"]
        assert case["expected"] == pytest.approx(wanted["expected"], abs=2e-4)


def check(lines: list[list[float]]) -> None:
    assert len(lines) == len(CASES)
    for numbers, case in zip(lines, CASES, strict=True):
        assert numbers == pytest.approx(list(case["expected"].values()), abs=1e-3)


def test_altd() -> None:
    for case in CASES:
        given, (x, y, yaw, pitch) = case["given"], case["given"]["beam"]
        place = dict(zip(("x_mm", "y_mm", "z_mm"), given["lever_mm"], strict=True))
        machine = {
            "roll_deg": given["roll_deg"],
            "roll_sigma_deg": given["sigma_roll_deg"],
            "beam_inclination_mm_per_m": given["inclination_mm_per_m"],
            "mount_sigma_deg": 0.0,
            "points": [{"name": "p", "sigma_mm": given["sigma_lever_mm"], **place}],
        }
        angles = np.degrees(np.arctan(np.array([yaw, pitch]) / 1000.0))
        per_deg = 1000.0 * np.radians(1.0) / np.cos(np.radians(angles)) ** 2
        factors = np.array([1.0, 1.0, *per_deg])
        covariance = np.array(given["covariance"]) / np.outer(factors, factors)
        joint = Joint(("x_mm", "y_mm", "yaw_deg", "pitch_deg"), covariance, covariance, factors)
        beam = Beam(x, y, *angles.tolist(), *np.sqrt(np.diag(covariance)).tolist())
        points = MachinePoints(Machine.model_validate(machine), Installation())
        found = points.finish(measured(beam, joint=joint))
        numbers = [found.number("p_right_mm"), found.number("p_up_mm")]
        numbers += [found.sigma("p_right_mm"), found.sigma("p_up_mm")]
        assert numbers == pytest.approx(list(case["expected"].values()), abs=1e-3)


def test_python() -> None:
    command = [sys.executable, EXAMPLES / "python" / "machine_point.py"]
    done = subprocess.run(command, input=VECTORS.read_text(), capture_output=True, text=True, check=True)
    check([[float(number) for number in line.split()] for line in done.stdout.splitlines()])


def numbers_of(given: dict[str, Any]) -> list[float]:
    flat: list[float] = []
    for value in given.values():
        flat += np.ravel(value).tolist()
    return flat


def test_c(tmp_path: Path) -> None:
    program, source = tmp_path / "machine_point", EXAMPLES / "c" / "machine_point.c"
    options = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O2"]
    subprocess.run([need_program("cc"), *options, "-o", program, source, "-lm"], check=True)
    lines = "".join(" ".join(map(repr, numbers_of(case["given"]))) + "\n" for case in CASES)
    done = subprocess.run([program], input=lines, capture_output=True, text=True, check=True)
    check([[float(number) for number in line.split()] for line in done.stdout.splitlines()])
    assert subprocess.run([program], input="1 2 3", text=True, check=False).returncode == 1


def test_structured_text() -> None:
    library, lines = Library((EXAMPLES / "structured_text" / "altd_machine.st").read_text()), []
    for case in CASES:
        given, point = case["given"], library.new("ALTD_POINT")
        matrix, (px, py, pz) = given["covariance"], given["lever_mm"]
        point(
            **dict(zip(("x", "y", "yaw", "pitch"), given["beam"], strict=True)),
            c=[matrix[row][column] for row in range(4) for column in range(row, 4)],
            roll=given["roll_deg"],
            sigma_roll=given["sigma_roll_deg"],
            inclination=given["inclination_mm_per_m"],
            px=px,
            py=py,
            pz=pz,
            sigma_p=given["sigma_lever_mm"],
        )
        lines.append([point.v[name] for name in ("right", "up", "sigma_right", "sigma_up")])
    check(lines)
