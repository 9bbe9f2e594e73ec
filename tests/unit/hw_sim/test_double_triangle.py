"""The simulated 3-PRP machine: its motion, its errors, and the singular poses it cannot pass."""

import contextlib
import math

import numpy as np
import numpy.typing as npt
import pytest

from altd.instruments.planar.machine.geometry_fit import fit_geometry
from altd.instruments.planar.machine.kinematics import poses_of
from altd.instruments.planar.machine.singularities import concurrent_line
from hw_sim.double_triangle import STEP_MM, DoubleTriangle, JammedError, MachineFlaws, source_machine
from studies.planar_machine import double_triangle

HEIGHT_MM = math.sqrt(600.0**2 - 250.0**2)
FIXED = np.array([(0.0, 0.0), (500.0, 0.0), (250.0, HEIGHT_MM)])
MOVING = np.array([(0.0, 0.0), (250.0, -HEIGHT_MM), (500.0, 0.0)])


def machine(pose: tuple[float, float, float] = (60.0, 250.0, 0.0), **flaws: float) -> DoubleTriangle:
    return DoubleTriangle(FIXED, MOVING, np.array(pose), MachineFlaws(**flaws), seed=3)


def degrees_of(pose: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.array([pose[0], pose[1], math.degrees(pose[2])])


def test_it_moves_as_the_closed_form_says() -> None:
    """Two independent forward kinematics: Newton from place to place here, an angle's cosine there."""
    simulated, rng = machine(), np.random.default_rng(1)
    start = simulated.joints_mm
    for _ in range(30):
        simulated.move(start + rng.uniform(-40.0, 40.0, 3))
        both = poses_of(double_triangle(), simulated.joints_mm)
        assert np.abs(both - degrees_of(simulated.pose)).max(axis=1).min() < 1e-9


def test_joints_stop_at_whole_steps() -> None:
    simulated = machine()
    simulated.move(simulated.joints_mm + np.array([0.26 * STEP_MM, 10.0, -10.011]))
    assert simulated.joints_mm / STEP_MM == pytest.approx(np.round(simulated.joints_mm / STEP_MM), abs=1e-9)


def test_it_jams_at_a_type_2_pose() -> None:
    """Driven on from there, the triangle has no place to go: the modes have met."""
    simulated, reached = machine((0.0, 170.0, math.radians(30.0))), 0
    for step_mm in (8.0, 1.0, 0.1):
        while not _jams(simulated, step_mm):
            reached += 1
    assert reached > 5
    at = degrees_of(simulated.pose)
    line = concurrent_line(double_triangle(), at[2])
    assert abs(line.normal @ at[:2] - line.offset_mm) < 5.0


def _jams(simulated: DoubleTriangle, step_mm: float) -> bool:
    """Drive two joints on by a step; where that jams, the machine has not moved."""
    before, wanted = simulated.pose, simulated.joints_mm + np.array([0.0, step_mm, step_mm])
    try:
        simulated.move(wanted)
    except JammedError:
        assert simulated.pose is before
        return True
    return False


def test_lost_steps_displace_it_for_good() -> None:
    true, losing = machine(), machine(lost_share=0.01)
    for moved in (40.0, -40.0):
        for each in (true, losing):
            each.move(each.joints_mm + np.array([moved, 0.0, 0.0]))
    assert losing.joints_mm == pytest.approx(true.joints_mm)
    assert np.hypot(*(losing.pose - true.pose)[:2]) > 0.02


@pytest.mark.long
def test_its_geometry_is_found_from_its_poses() -> None:
    """Eq. 2.63 on the machine's own motion, with the uncertainty of a camera and of one step."""
    simulated, rng = machine(place_mm=1.0, direction_deg=0.2, screw_ppm=500.0), np.random.default_rng(5)
    poses, joints = [], []
    while len(poses) < 60:
        with contextlib.suppress(JammedError):
            simulated.move(rng.uniform((40.0, 0.0, 150.0), (330.0, 250.0, 560.0)))
            poses.append(degrees_of(simulated.pose))
            joints.append(simulated.joints_mm)
    sigmas = np.array([0.03, 0.03, 0.02])
    measured = np.array(poses) + rng.normal(0.0, sigmas, (len(poses), 3))
    fitted = fit_geometry(double_triangle(), measured[:40], joints[:40], np.diag(sigmas**2), 1e-3)
    assert fitted.chi2 / fitted.degrees_of_freedom == pytest.approx(1.0, abs=0.4)
    for machine_of, limit_mm in ((fitted.machine, 0.05), (double_triangle(), np.inf)):
        reached = poses_of(machine_of, joints[40:])
        error = np.abs(reached - np.array(poses[40:])[:, None])[..., :2].max(axis=2).min(axis=1)
        assert np.sqrt(np.mean(error**2)) < limit_mm
    assert np.sqrt(np.mean(error**2)) > 0.5  # by its design, without the fit


def test_the_source_s_machine_moves_as_the_source_says() -> None:
    """Eq. 2.64, from (0, 700, 0), to the nearest step of each joint."""
    simulated = source_machine()
    start = degrees_of(simulated.pose)
    assert start == pytest.approx([0.0, 700.0, 0.0], abs=0.03)
    simulated.move(simulated.joints_mm + np.array([0.0, -45.0, 45.0]))
    assert degrees_of(simulated.pose) - start == pytest.approx([18.75, -40.91, 0.0], abs=0.005)
