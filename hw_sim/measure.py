"""``python -m hw_sim measure``: record poses of the beam with their truth, one after another."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from altd.files.writing import check_replaceable, write_file
from hw_sim.arguments import add_common_arguments, at_least_one, terminal_progress
from hw_sim.beam import BeamPose
from hw_sim.faults import parse_faults
from hw_sim.recording import Progress, recording
from hw_sim.unit import Unit, UnitConfig

MAX_YAW_SLOPE, MAX_PITCH_SLOPE = 0.110, 0.250
"""Maximum slopes by specification (App. A.1)."""

POSES_STREAM = 5
"""Separate random stream for the poses, apart from that of the frames."""

HALF_AREA_MM = (70.0, 55.0)
"""Half of the 140 × 110 mm of App. A.1, which contain both spots of every pose."""


def random_poses(
    count: int,
    target_distance_mm: float,
    rng: np.random.Generator,
    half_area_mm: tuple[float, float] = HALF_AREA_MM,
    max_slopes: tuple[float, float] = (MAX_YAW_SLOPE, MAX_PITCH_SLOPE),
) -> list[BeamPose]:
    """Draw poses with even front spots over the area and slopes as even as the rear target allows."""
    poses: list[BeamPose] = []
    while len(poses) < count:
        x_mm, y_mm = rng.uniform(-1.0, 1.0, size=2) * half_area_mm
        slope_x, slope_y = rng.uniform(-1.0, 1.0, size=2) * max_slopes
        pose = BeamPose(float(x_mm), float(y_mm), float(slope_x), float(slope_y))
        if np.all(np.abs(pose.at(target_distance_mm)) <= half_area_mm):
            poses.append(pose)
    return poses


def record_measurement(
    folder: Path, unit: Unit, poses: Sequence[BeamPose], frame_sets: int, progress: Progress
) -> dict[str, object]:
    """Write ``frame_sets`` frame pairs of each pose into ``folder``; return the truth, ready for JSON."""
    truth = []
    with recording(folder, unit, "measurement", len(poses) * frame_sets, progress) as recorder:
        for pose in poses:
            unit.place(pose)
            at = unit.truth(recorder.t_ns, vibration=False)
            truth.append({"x_mm": at.x_mm, "y_mm": at.y_mm, "slope_x": at.slope_x, "slope_y": at.slope_y})
            for _ in range(frame_sets):
                recorder.expose(pose)
    return {"window": frame_sets, "poses": truth}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of the measurement."""
    add_common_arguments(parser)
    parser.add_argument("--truth", type=Path, required=True, metavar="FILE", help="JSON file for the truth")
    parser.add_argument("--poses", type=at_least_one, default=30, help="number of beams (default: 30)")
    parser.add_argument("--exposures", type=at_least_one, default=4, help="exposures per beam (default: 4)")
    parser.add_argument(
        "--faults", default="", metavar="NAME,...", help="faults, by the names in hw_sim/faults.py"
    )


def run(arguments: argparse.Namespace) -> int:
    """Record a measurement; raises BadInputError."""
    faults = parse_faults(filter(None, arguments.faults.split(",")))
    unit = Unit(UnitConfig(seed=arguments.seed, faults=faults, hard=arguments.hard))
    rng = np.random.default_rng([arguments.seed, POSES_STREAM])
    poses = random_poses(arguments.poses, unit.config.target_distance_mm, rng)
    truth_file: Path = arguments.truth
    check_replaceable(truth_file)
    truth = record_measurement(
        arguments.output, unit, poses, arguments.exposures, terminal_progress("measure")
    )
    write_file(truth_file, (json.dumps(truth, indent=1) + "\n").encode())
    return 0
