"""Calibration of a planar machine: poses by plain geometry, those of the simulated one, and wrong ones."""

import math
from collections.abc import Callable
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from altd.calibration.planar_machine import MachineFile, calibrate_machine
from altd.config.loading import load_tables
from altd.errors import BadInputError
from altd.instruments.planar.machine.kinematics import PlanarMachine, poses_of
from hw_sim.double_triangle import STEP_MM, random_motion, source_machine

Array = npt.NDArray[np.float64]

EXAMPLE = Path(__file__).parents[3] / "config" / "planar-machine.toml"
HEIGHT_MM = math.sqrt(600.0**2 - 250.0**2)
FIXED = np.add([(0.0, 0.0), (500.0, 0.0), (250.0, HEIGHT_MM)], (-310.0, 450.0 + HEIGHT_MM / 3))
MOVING = np.subtract([(0.0, 0.0), (250.0, -HEIGHT_MM), (500.0, 0.0)], (250.0, -HEIGHT_MM / 3))
SIGMAS, COMMON = np.array([0.002, 0.002, 0.0015]), 0.001
"""Of a measured pose in mm and °, and the part that all poses share, as of a camera (docs/planar.md)."""
POSES = 50


@pytest.fixture(scope="module")
def design() -> MachineFile:
    return load_tables(EXAMPLE, MachineFile)


@cache
def made(seed: int) -> tuple[Array, Array, Array]:
    """Parameters (3, 6) of a machine with errors, its joints and true poses."""
    rng, parameters, lines = np.random.default_rng(seed), [], []
    for leg in range(3):
        sides = FIXED[(leg + 1) % 3] - FIXED[leg], MOVING[(leg + 1) % 3] - MOVING[leg]
        rail, edge = (math.atan2(side[1], side[0]) + math.radians(0.1) * rng.normal() for side in sides)
        start, point = FIXED[leg] + rng.normal(0.0, 0.5, 2), MOVING[leg] + rng.normal(0.0, 0.5, 2)
        scale, offset = 1.0 + 2e-4 * rng.normal(), point @ (-math.sin(edge), math.cos(edge))
        parameters.append([*start, math.degrees(rail), scale, math.degrees(edge), offset])
        lines.append((start, scale * np.array([math.cos(rail), math.sin(rail)]), point, edge))
    drawn = rng.uniform((-45.0, 668.0, -40.0), (45.0, 732.0, 28.0), (300, 3))
    crossed = np.array([[crossing_mm(*line, *pose) for line in lines] for pose in drawn])
    reached = ((crossed > 0.0) & (crossed < (500.0, 600.0, 600.0))).all(axis=1)
    return np.array(parameters), crossed[reached][: POSES + 20], drawn[reached][: POSES + 20]


def crossing_mm(start: Array, along: Array, point: Array, edge: float, *pose: float) -> float:
    """Joint at which a rail meets an edge of the plate in a pose."""
    a, b, phi = pose[0], pose[1], math.radians(pose[2])
    cosine, sine, angle = math.cos(phi), math.sin(phi), edge + phi
    placed = np.array([[cosine, -sine], [sine, cosine]]) @ point + (a, b)
    system = np.column_stack([along, (-math.cos(angle), -math.sin(angle))])
    return float(np.linalg.solve(system, placed - start)[0])


@cache
def measured(seed: int) -> Array:
    """The first poses as a camera measures them, and joints that err by a step, evenly distributed."""
    rng, (_, joints, poses) = np.random.default_rng([seed, 1]), made(seed)
    random = np.sqrt(SIGMAS**2 - COMMON**2)
    poses = poses[:POSES] + rng.normal(0.0, COMMON, 3) + rng.normal(0.0, random, (POSES, 3))
    joints = joints[:POSES] + STEP_MM * rng.uniform(-0.5, 0.5, (POSES, 3))
    return np.hstack([joints, poses, np.tile(SIGMAS, (POSES, 1)), np.tile(random, (POSES, 1))])


def rows(count: int) -> list[str]:
    return [f"row {number}" for number in range(count)]


def errors_of(machine: PlanarMachine, joints: Array, poses: Array) -> Array:
    """Computed minus true poses."""
    off = poses_of(machine, joints) - poses[:, None]
    return np.asarray(off[range(len(poses)), np.abs(off[..., 2]).argmin(axis=1)])


def test_the_example_is_the_simulated_machine(design: MachineFile) -> None:
    simulated = source_machine()
    moved = [(simulated.joints_mm, pose) for pose in islice(random_motion(simulated, (45, 32, 40)), 8)]
    joints, poses = (np.array(each) for each in zip(*moved, strict=True))
    assert np.abs(errors_of(design.machine, joints, poses)).max() < 2e-4


def test_parameters_err_by_their_sigma_and_unseen_poses_are_predicted(design: MachineFile) -> None:
    ratios, chi2, unseen, by_design = [], [], [], []
    for seed in range(30):
        parameters, joints, poses = made(seed)
        fitted = calibrate_machine(design, rows(POSES), measured(seed))
        errors = fitted.machine.parameters - parameters
        errors[:, [2, 4]] = (errors[:, [2, 4]] + 180.0) % 360.0 - 180.0
        ratios.append(errors / fitted.sigmas)
        chi2.append(fitted.chi2 / fitted.degrees_of_freedom)
        unseen.append(errors_of(fitted.machine, joints[POSES:], poses[POSES:]))
        by_design.append(errors_of(design.machine, joints[POSES:], poses[POSES:]))
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(0.95, abs=0.12)
    assert np.mean(chi2) == pytest.approx(0.9, abs=0.05)
    rms, rms_by_design = (np.sqrt(np.mean(np.square(each), axis=(0, 1))) for each in (unseen, by_design))
    assert (rms < (0.01, 0.01, 0.006)).all()
    assert (rms_by_design > 50 * rms).all()


def changed(columns: slice, by: Callable[[Array], Array], of: slice = slice(None)) -> Callable[[], Array]:
    def wrong() -> Array:
        poses = measured(3).copy()
        poses[of, columns] = by(poses[of, columns])
        return poses

    return wrong


NINTH, LATER = slice(9, 10), slice(20, None)
JOINT_2, JOINTS, PLACE, PHI = slice(1, 2), slice(0, 3), slice(3, 5), slice(5, 6)
DISAGREE = ": lost steps, exchanged joints, another machine, or too small a sigma_joint_mm"
WRONG = {
    "four steps at one pose": (
        changed(JOINT_2, lambda of: of + 4 * STEP_MM, NINTH),
        "row 9: joints and pose are ",
        f"sigma from the fit of the other poses{DISAGREE}",
    ),
    "two steps lost for good": (changed(JOINT_2, lambda of: of + 2 * STEP_MM, LATER), "row ", DISAGREE),
    "exchanged at one pose": (
        changed(JOINTS, lambda of: of[:, ::-1], NINTH),
        "row 9: joints and pose contradict the design by ",
        " mm, most others by less than ",
    ),
    "exchanged": (changed(JOINTS, lambda of: of[:, [1, 0, 2]]), "row 0: rail_start", "far from the design"),
    "the rail's other end": (
        changed(JOINT_2, lambda of: 600.0 - of),
        "row 0: rail_start_x_mm of leg 2",
        "far",
    ),
    "another scale": (changed(PLACE, lambda of: 1.01 * of), "row 0: joint_scale of leg 1", "far from the"),
    "those of the pose before": (
        changed(JOINTS, lambda of: np.roll(of, 1, axis=0)),
        "row 0: ",
        "joints, poses and design do not belong together",
    ),
    "mirrored": (changed(PHI, lambda of: -of), "row ", ""),
    "one orientation": (
        changed(PHI, lambda of: 0.0 * of),
        "row 0: the poses do not determine ",
        "edge_offset_mm of leg",
    ),
    "almost one": (changed(PHI, lambda of: 1e-3 * of), "row ", ""),
    "five poses": (lambda: measured(3)[:5], "row 0: the poses do not determine ", " of leg "),
    "six poses": (lambda: measured(3)[:6], "row ", "too few other poses check this one"),
    "ten poses": (lambda: measured(3)[:10], "row ", "too few other poses check this one"),
}


@pytest.mark.parametrize("name", WRONG)
def test_poses_that_do_not_fit_are_refused(design: MachineFile, name: str) -> None:
    poses, begin, said = WRONG[name]
    with pytest.raises(BadInputError) as refused:
        calibrate_machine(design, rows(len(poses())), poses())
    assert str(refused.value).startswith(begin)
    assert said in str(refused.value)


def test_a_single_lost_step_is_within_the_sigma_of_a_joint(design: MachineFile) -> None:
    """It passes unless the joints are known better; the parameters then err by less than four sigmas."""
    for leg in range(3):
        wrong = measured(3).copy()
        wrong[9, leg] += STEP_MM
        fitted = calibrate_machine(design, rows(POSES), wrong)
        errors = fitted.machine.parameters - made(3)[0]
        errors[:, [2, 4]] = (errors[:, [2, 4]] + 180.0) % 360.0 - 180.0
        assert np.abs(errors / fitted.sigmas).max() < 4.0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "sigma_joint_mm = 0.0072",
            "",
            "sigma_joint_mm: this key is missing; possible: number",
        ),
        ("rail_deg = 0.00000", "rail_deg = nan", "line 7, column 12: legs.0.rail_deg: nan is not a finite"),
        (
            "rail_deg",
            "rial_deg",
            "line 7, column 1: legs.0.rial_deg: there is no such key",
        ),
        ("[-310.0000, 631.8119]", "-310.0", "line 6, column 17: legs.0.rail_start_mm: -310.0 is not a list"),
        ("[[legs]]", "[legs]", "line 12, column 1: not TOML"),
        ("[unit]", "", "legs: this key is missing"),
    ],
)
def test_each_fault_of_a_design_is_a_line_and_a_place(tmp_path: Path, old: str, new: str, said: str) -> None:
    path, text = tmp_path / "design.toml", EXAMPLE.read_text()
    path.write_text(text.replace(old, new, 1) if old in text else "sigma_joint_mm = 1")
    with pytest.raises(BadInputError) as refused:
        load_tables(path, MachineFile)
    assert refused.value.lines[0].startswith(f"{path}: {said}"), refused.value.lines
