"""A simulated drive along a curve: errors of what ``altd axis`` writes, against vectors in the world.

The world is east, north and up, in m. Its axis is a clothoid and an arc by Fresnel integrals and a circle,
with a parabola in height. The machine's attitude is a product of rotations; a beam is a straight line in the
tunnel. altd only gets what a surveyor and a unit would state, each with its error drawn.
"""

import json
import math
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import fresnel
from support import measurements

from altd.answers.axis import Guidance, message_of
from altd.axis import AxisDocument, BeamLine
from altd.config import Installation, Machine
from altd.instruments.beam.instrument import quantities_of
from altd.instruments.beam.points import MachinePoints
from altd.instruments.beam.solver import Beam
from altd.records import FloatArray
from altd.records.joint import Joint
from altd.records.sensors import Quality, SensorValue
from altd.status.measurement_json import as_object

DRIVES, STATIONS_M = 60, (12.0, 40.0, 61.0, 97.0)
RADIUS_M, CLOTHOID_M, LENGTH_M = 300.0, 60.0, 120.0
LEVERS_MM = np.array([[0.0, 0.0, 0.0], [310.0, -1250.0, 4800.0], [-900.0, 400.0, -2000.0]])
MOUNT_DEG, MOUNT_SIGMA_DEG, LEVER_SIGMA_MM = np.array([1.2, -0.7, 2.5]), 0.02, 1.0
ROLL_SIGMA_DEG, ROLL_RATE_DEG_PER_S = 0.02, 0.03
START_SIGMA_MM, AZIMUTH_SIGMA_DEG, INCLINATION_SIGMA, DISTANCE_SIGMA_MM = (2.0, 2.0, 1.5), 0.0012, 0.02, 3.0
TIME = datetime(2026, 11, 20, 8, 0, tzinfo=UTC)


def true_axis(chainage_m: float) -> tuple[FloatArray, FloatArray]:
    """Place (3,) on the axis and its horizontal direction (3,): to the north at 0, then to the right."""
    scale = math.sqrt(math.pi * CLOTHOID_M * RADIUS_M)
    way = min(chainage_m, CLOTHOID_M)
    sine, cosine = fresnel(way / scale)
    east, north, turn = scale * sine, scale * cosine, way**2 / (2 * CLOTHOID_M * RADIUS_M)
    beyond = chainage_m - way
    middle = np.array([east + RADIUS_M * math.cos(turn), north - RADIUS_M * math.sin(turn)])
    azimuth = turn + beyond / RADIUS_M
    if beyond > 0:
        east, north = middle + RADIUS_M * np.array([-math.cos(azimuth), math.sin(azimuth)])
    height = -0.03 * chainage_m + (0.05 / (2 * 80.0)) * np.clip(chainage_m - 20.0, 0, 80.0) ** 2
    height += 0.05 * max(chainage_m - 100.0, 0.0)
    return np.array([east, north, height]), np.array([math.sin(azimuth), math.cos(azimuth), 0.0])


def true_offsets(point: FloatArray, near_m: float) -> FloatArray:
    """Chainage, m, and the distances to the right and above, m, by the smallest horizontal distance."""

    def apart(chainage_m: float) -> float:
        return float(np.sum((point - true_axis(chainage_m)[0])[:2] ** 2))

    limits = (max(near_m - 15.0, 0.0), near_m + 15.0)
    chainage_m = minimize_scalar(apart, bounds=limits, method="bounded", options={"xatol": 1e-9}).x
    foot, along = true_axis(chainage_m)
    right = np.array([along[1], -along[0], 0.0])
    return np.array([chainage_m, (point - foot) @ right, point[2] - foot[2]])


def turned(heading: float, grade: float, roll: float) -> FloatArray:
    """Axes right, up and ahead of a body, as columns: rolled clockwise, then raised, then headed; rad."""
    (c1, s1), (c2, s2), (c3, s3) = ((math.cos(each), math.sin(each)) for each in (heading, grade, roll))
    headed = np.array([[c1, s1, 0], [-s1, c1, 0], [0, 0, 1]])
    raised = np.array([[1, 0, 0], [0, c2, -s2], [0, s2, c2]])
    rolled = np.array([[c3, 0, s3], [0, 1, 0], [-s3, 0, c3]])
    level = np.array([[1, 0, 0], [0, 0, 1], [0, 1, 0]])  # right, up and ahead of a body that heads north
    product: FloatArray = headed @ raised @ rolled @ level
    return product


def axis_document() -> AxisDocument:
    end = true_axis(LENGTH_M)[0]
    heights = [(0.0, 0.0, 0.0), (60.0, -1.8, 80.0), (LENGTH_M, -0.6, 0.0)]
    return AxisDocument.model_validate(
        {
            "format": "altd-axis/1",
            "name": "curve",
            "max_offset_m": 3.0,
            "start": {"chainage_m": 0.0, "east_m": 0.0, "north_m": 0.0, "azimuth_deg": 0.0},
            "horizontal": [
                {"length_m": CLOTHOID_M, "start_radius_m": None, "end_radius_m": RADIUS_M},
                {"length_m": 60.0, "start_radius_m": RADIUS_M, "end_radius_m": RADIUS_M},
            ],
            "end": {"east_m": float(end[0]), "north_m": float(end[1])},
            "vertical": [
                dict(zip(("chainage_m", "height_m", "curve_length_m"), each, strict=True)) for each in heights
            ],
        }
    )


class Drive:
    """One machine, whose levers and mounting have an error each that stays."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.levers_mm = LEVERS_MM + rng.normal(0, LEVER_SIGMA_MM, LEVERS_MM.shape)
        self.mount_deg = MOUNT_DEG + rng.normal(0, MOUNT_SIGMA_DEG, 3)

    def rows(self, chainage_m: float) -> tuple[list[Any], FloatArray]:
        """Rows of ``altd axis`` for a station, and the true chainage and distances (3, 3), m."""
        rng, (middle, along) = self.rng, true_axis(chainage_m)
        heading = math.atan2(along[0], along[1]) + rng.uniform(-0.01, 0.01)
        machine = turned(heading, rng.uniform(-0.03, 0.02), math.radians(rng.uniform(-4.0, 4.0)))
        front = middle + rng.uniform(-0.05, 0.05, 3)
        unit = machine @ turned(*np.radians(self.mount_deg))[[0, 2, 1]]
        towards = unit @ [rng.uniform(-0.03, 0.03), rng.uniform(-0.03, 0.03), 1.0]
        towards /= np.linalg.norm(towards)
        hit_mm, distance_m = rng.uniform(-50, 50, 2), rng.uniform(40.0, 90.0)
        start = front + unit[:, :2] @ hit_mm / 1000 - distance_m * towards
        azimuth_deg = math.degrees(math.atan2(towards[0], towards[1])) % 360
        inclination = 1000 * towards[2] / math.hypot(*towards[:2])
        stated = start + rng.normal(0, START_SIGMA_MM) / 1000
        beam = BeamLine.model_validate(
            {
                "format": "altd-beam/1",
                "serial": "T",
                "time": "2026-11-20T07:00:00Z",
                "by": "test",
                **dict(zip(("east_m", "north_m", "height_m"), stated.tolist(), strict=True)),
                **dict(
                    zip(("sigma_east_mm", "sigma_north_mm", "sigma_height_mm"), START_SIGMA_MM, strict=True)
                ),
                "azimuth_deg": (azimuth_deg + rng.normal(0, AZIMUTH_SIGMA_DEG)) % 360,
                "sigma_azimuth_deg": AZIMUTH_SIGMA_DEG,
                "inclination_mm_per_m": inclination + rng.normal(0, INCLINATION_SIGMA),
                "sigma_inclination_mm_per_m": INCLINATION_SIGMA,
                "sigma_distance_mm": DISTANCE_SIGMA_MM,
            }
        )
        settings = machine_settings(beam.inclination_mm_per_m)
        document = self.message(unit, towards, hit_mm, settings)
        document["distance_m"] = distance_m + rng.normal(0, DISTANCE_SIGMA_MM) / 1000
        guidance = Guidance(axis_document().axis, beam, settings, Installation())
        rows = list(guidance.rows(message_of(json.dumps(document).encode())))
        points = front + self.levers_mm / 1000 @ machine.T
        return rows, np.array([true_offsets(point, chainage_m) for point in points])

    def message(
        self, unit: FloatArray, towards: FloatArray, hit_mm: FloatArray, settings: Machine
    ) -> dict[str, Any]:
        """The measurement that a unit would publish, with drawn errors."""
        seen = towards @ unit
        yaw_pitch_deg = np.degrees(np.arctan(seen[:2] / seen[2]))
        root = np.array([[0.03, 0, 0, 0], [0, 0.03, 0, 0], [-0.004, 0, 0.003, 0], [0, -0.004, 0, 0.003]])
        beam = np.concatenate([hit_mm, yaw_pitch_deg]) + root @ self.rng.normal(size=4)
        known = root @ root.T
        per_deg = 1000 * math.radians(1) / np.cos(np.radians(beam[2:])) ** 2
        joint = Joint(
            ("x_mm", "y_mm", "yaw_deg", "pitch_deg"), known, known / 4, np.array([1.0, 1.0, *per_deg])
        )
        roll_deg = math.degrees(math.atan2(-unit[2, 0], unit[2, 1]))
        roll_deg += self.rng.normal(0, math.hypot(ROLL_SIGMA_DEG, ROLL_RATE_DEG_PER_S))
        roll = SensorValue(
            Quality.GOOD, value=roll_deg, sigma=ROLL_SIGMA_DEG, expires_ns=1 << 62, rate=ROLL_RATE_DEG_PER_S
        )
        sigmas = np.sqrt(np.diag(known)).tolist()
        measured = measurements.measured(
            Beam(*beam.tolist(), *sigmas),
            joint=joint,
            time=TIME,
            quantities=quantities_of(Installation(), settings).with_sensor("roll_deg"),
        ).with_sensors({"roll_deg": roll})
        finished = MachinePoints(settings, Installation()).finish(replace(measured, status=()))
        return as_object(finished)


def machine_settings(inclination_mm_per_m: float) -> Machine:
    names = ("x_mm", "y_mm", "z_mm")
    return Machine.model_validate(
        {
            "points": [
                {
                    "name": f"p{at}",
                    "sigma_mm": LEVER_SIGMA_MM,
                    **dict(zip(names, lever.tolist(), strict=True)),
                }
                for at, lever in enumerate(LEVERS_MM)
            ],
            "mount_sigma_deg": MOUNT_SIGMA_DEG,
            "beam_inclination_mm_per_m": inclination_mm_per_m,
            **dict(
                zip(("mount_yaw_deg", "mount_pitch_deg", "mount_roll_deg"), MOUNT_DEG.tolist(), strict=True)
            ),
        }
    )


@pytest.mark.long
def test_errors_of_a_drive_are_those_that_are_stated() -> None:
    errors_mm, sigmas_mm = [], []
    keys = ("chainage", "offset_right", "offset_up")
    for seed in range(DRIVES):
        drive = Drive(np.random.default_rng([59, seed]))
        for chainage_m in STATIONS_M:
            rows, truth = drive.rows(chainage_m)
            for row, of_point in zip(rows, truth, strict=True):
                assert row.get("reason") is None, row
                found = [1000 * row["chainage_m"], row["offset_right_mm"], row["offset_up_mm"]]
                errors_mm.append(found - 1000 * of_point)
                sigmas_mm.append([row[f"sigma_{key}_mm"] for key in keys])
    errors, sigmas = (np.array(each).reshape(DRIVES, -1, 3, 3) for each in (errors_mm, sigmas_mm))
    z = np.sqrt(np.mean((errors / sigmas) ** 2, axis=(0, 1)))
    rms_mm = np.sqrt(np.mean(errors**2, axis=(0, 1)))
    print("rms of error/sigma, points by chainage, right, up:\n", z.round(3))
    print("rms error, mm:\n", rms_mm.round(2))
    assert (z > 0.8).all()
    assert (z < 1.25).all()
