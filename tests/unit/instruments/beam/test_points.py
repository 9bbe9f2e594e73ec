"""Points of the machine, against geometry in a world of its own: vectors east, north and up."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support import measurements
from support.clock import FakeClock
from support.world import World

from altd.config import Installation, Machine
from altd.instruments.beam.instrument import QUANTITIES, quantities_of
from altd.instruments.beam.points import MachinePoints
from altd.instruments.beam.solver import Beam
from altd.records import Finding, FloatArray, Measurement
from altd.records.joint import Joint
from altd.records.sensors import Quality, SensorValue
from altd.status.board import Board
from altd.status.measurement_json import as_object
from altd.status.proof import Identity

LEVERS_MM = np.array([[0.0, 0.0, 0.0], [310.0, -1250.0, 4800.0], [-900.0, 400.0, -2000.0]])


def machine_of(levers_mm: FloatArray, **more: Any) -> Machine:
    places = [dict(zip(("x_mm", "y_mm", "z_mm"), lever.tolist(), strict=True)) for lever in levers_mm]
    points = [{"name": f"p{number}", "sigma_mm": 0.0, **place} for number, place in enumerate(places)]
    sigmas = {"roll_sigma_deg": 0.0, "mount_sigma_deg": 0.0}
    return Machine.model_validate({"points": points, **sigmas, **more})


def measured(beam: tuple[float, float, float, float], covariance: FloatArray | None = None) -> Measurement:
    """A measurement of a beam, with the covariance of x, y, yaw and pitch in mm and degrees."""
    known = np.zeros((4, 4)) if covariance is None else covariance
    sigmas = np.sqrt(np.diag(known)).tolist()
    per_deg = [1000 * math.radians(1) / math.cos(math.radians(angle)) ** 2 for angle in beam[2:]]
    joint = Joint(("x_mm", "y_mm", "yaw_deg", "pitch_deg"), known, known / 4, np.array([1.0, 1.0, *per_deg]))
    return measurements.measured(Beam(*beam, *sigmas), joint=joint)


def distances_of(measurement: Measurement) -> FloatArray:
    keys = [f"p{number}_{axis}_mm" for number in range(len(LEVERS_MM)) for axis in ("right", "up")]
    return np.array([measurement.values[key].value for key in keys if key in measurement.values]).reshape(
        -1, 2
    )


UNITS_DEG = [(0.0, 0.0, 0.0), (4.0, -2.0, 5.0), (31.0, 1.7, -14.0)]


@pytest.mark.parametrize("unit_deg", UNITS_DEG)
@pytest.mark.parametrize("plane_mm", [0.0, -1500.0])
def test_points_are_where_they_are_in_the_world(
    unit_deg: tuple[float, float, float], plane_mm: float
) -> None:
    world = World(unit_deg, (unit_deg[0] + 3.1, unit_deg[1] - 4.2))
    grade = 1000 * math.tan(math.radians(unit_deg[1] - 4.2))
    machine = machine_of(LEVERS_MM, roll_deg=world.roll_deg, beam_inclination_mm_per_m=grade)
    points = MachinePoints(machine, Installation(reference_plane_mm=plane_mm))
    finished = points.finish(measured(world.seen(plane_mm)))
    assert np.allclose(distances_of(finished), world.distances(LEVERS_MM), atol=1e-6)


def test_signs_and_offsets_of_the_controller_change_nothing() -> None:
    world = World((2.0, 0.5, 3.0), (4.0, 1.0))
    turned = Installation(sign_x=-1, sign_pitch=-1, offset_y_mm=7.0, offset_yaw_deg=2.5)
    x, y, yaw, pitch = world.seen()
    grade = 1000 * math.tan(math.radians(1.0))
    machine = machine_of(LEVERS_MM, roll_deg=world.roll_deg, beam_inclination_mm_per_m=grade)
    finished = MachinePoints(machine, turned).finish(measured((-x, y + 7.0, yaw + 2.5, -pitch)))
    assert np.allclose(distances_of(finished), world.distances(LEVERS_MM), atol=1e-6)


def test_a_unit_that_is_mounted_askew_is_turned_into_the_machine() -> None:
    """The same machine in the same world, once through its own axes and once through those of the unit."""
    world, askew = World((2.0, 0.5, 3.0), (4.0, 1.0)), (1.2, -0.7, 2.5)
    grade = 1000 * math.tan(math.radians(1.0))
    yaw, pitch, roll = np.radians(askew)
    z = np.array([math.sin(yaw) * math.cos(pitch), math.sin(pitch), math.cos(yaw) * math.cos(pitch)])
    right = np.array([math.cos(yaw), 0.0, -math.sin(yaw)])
    upright = np.cross(z, right)
    x = math.cos(roll) * right - math.sin(roll) * upright
    y = math.sin(roll) * right + math.cos(roll) * upright
    in_machine = LEVERS_MM @ np.array([x, y, z])
    names = ("mount_yaw_deg", "mount_pitch_deg", "mount_roll_deg")
    about: dict[str, float] = {"roll_deg": world.roll_deg, "beam_inclination_mm_per_m": grade}
    machine = machine_of(in_machine, **about, **dict(zip(names, askew, strict=True)))
    finished = MachinePoints(machine, Installation()).finish(measured(world.seen()))
    assert np.allclose(distances_of(finished), world.distances(LEVERS_MM), atol=1e-6)


def test_sigma_agrees_with_monte_carlo() -> None:
    """Errors of the beam that belong together, of roll, of the levers and of the mounting."""
    rng = np.random.default_rng(64)
    beam, sigma_mm, sigma_deg = (13.0, -8.0, 2.0, -3.0), 0.8, 0.03
    root = np.array([[0.02, 0, 0, 0], [0, 0.02, 0, 0], [-0.01, 0, 0.003, 0], [0, -0.01, 0, 0.003]])
    covariance = root @ root.T
    known: dict[str, Any] = {"roll_deg": 4.0, "roll_sigma_deg": 0.05, "mount_sigma_deg": sigma_deg}
    machine = machine_of(LEVERS_MM, **known)
    stated = [point.model_copy(update={"sigma_mm": sigma_mm}) for point in machine.points]
    machine = machine.model_copy(update={"points": tuple(stated)})
    finished = MachinePoints(machine, Installation()).finish(measured(beam, covariance))
    sigmas = [finished.sigma(key) for key in finished.linear]
    draws = []
    for _ in range(4000):
        levers = LEVERS_MM + rng.normal(0.0, sigma_mm, LEVERS_MM.shape)
        angles = rng.normal(0.0, sigma_deg, 3)
        about = dict(zip(("mount_yaw_deg", "mount_pitch_deg", "mount_roll_deg"), angles, strict=True))
        other = machine_of(levers, roll_deg=4.0 + rng.normal(0.0, 0.05), **about)
        drawn = tuple((np.array(beam) + root @ rng.normal(size=4)).tolist())
        draws.append(distances_of(MachinePoints(other, Installation()).finish(measured(drawn))).ravel())
    assert sigmas == pytest.approx(np.std(draws, axis=0), rel=0.05)
    scatter = [finished.sigma_random(key) for key in finished.linear]
    of_beam = MachinePoints(machine_of(LEVERS_MM, roll_deg=4.0), Installation())
    alone = of_beam.finish(measured(beam, covariance))
    assert scatter == pytest.approx([0.5 * (alone.sigma(key) or 0.0) for key in alone.linear])


def test_points_go_with_the_roll_and_with_the_beam() -> None:
    points = MachinePoints(machine_of(LEVERS_MM), Installation())
    without = measured((1.0, 2.0, 0.5, 0.5))
    assert points.finish(without).linear == {}
    roll = SensorValue(Quality.GOOD, value=1.0, sigma=0.05, t_ns=0, expires_ns=10**9)
    with_roll = without.with_sensors({"roll_deg": roll})
    known = points.finish(with_roll)
    assert len(known.linear) == 2 * len(LEVERS_MM)
    later = points.finish(known.at(2 * 10**9))
    assert (later.valid, later.linear, distances_of(later).size) == (True, {}, 0)
    blocked = points.finish(known.without_numbers(()))
    assert (blocked.valid, dict(blocked.linear)) == (False, {})


def test_no_point_outlives_its_roll_on_the_board_and_none_lacks_an_uncertainty() -> None:
    clock = FakeClock(10**9)
    said = SensorValue(Quality.GOOD, value=1.0, sigma=0.05, t_ns=10**9, expires_ns=18 * 10**8)
    machine = machine_of(LEVERS_MM[:1])
    points, quantities = MachinePoints(machine, Installation()), quantities_of(Installation(), machine)
    sensed = Finding(from_sensors={"roll_deg": said})
    board = Board(clock, 2.0, quantities, Identity(), lambda values: sensed, True, points.finish)
    board.publish(replace(measured((1.0, 2.0, 0.5, 0.5)), t_ns=10**9, quantities=quantities))
    fresh = board.read()
    assert fresh is not None
    assert as_object(fresh)["points"]["p0"]["right_mm"] is not None
    clock.now_ns = 19 * 10**8
    late = board.read()
    assert late is not None
    nothing = {"right_mm": None, "up_mm": None}
    assert (late.valid, as_object(late)["points"]) == (True, {"p0": {**nothing, "sigma": nothing}})
    clock.now_ns = 4 * 10**9
    stale = board.read()
    assert stale is not None
    assert (stale.valid, dict(stale.linear)) == (False, {})
    unknown = measured((1.0, 2.0, 0.5, 0.5), np.full((4, 4), np.nan)).with_sensors({"roll_deg": said})
    assert points.finish(unknown).linear == {}


def test_a_machine_that_rolls_has_the_roll_of_a_second_in_sigma() -> None:
    points, still = MachinePoints(machine_of(LEVERS_MM), Installation()), measured((0.0, 0.0, 0.0, 0.0))
    sigmas = []
    for rate in (0.0, 0.2):
        roll = SensorValue(Quality.GOOD, value=0.0, sigma=0.01, expires_ns=10**9, rate=rate)
        sigmas.append(points.finish(still.with_sensors({"roll_deg": roll})).sigma("p1_right_mm") or 0.0)
    assert sigmas == pytest.approx(
        [1250.0 * math.radians(0.01), 1250.0 * math.radians(math.hypot(0.01, 0.2))]
    )


def test_each_point_has_two_quantities_and_a_unit_without_points_none() -> None:
    keys = [each.key for each in quantities_of(Installation(), machine_of(LEVERS_MM[:1])).of_unit]
    assert keys == [*(each.key for each in QUANTITIES.of_unit), "p0_right_mm", "p0_up_mm"]
    assert quantities_of(Installation()).of_unit == QUANTITIES.of_unit
