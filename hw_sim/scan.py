"""``python -m hw_sim scan``: the calibration scan of Sec. 3.5.7, recorded."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from hw_sim.arguments import add_common_arguments, at_least_one, terminal_progress
from hw_sim.beam import BeamPose
from hw_sim.recording import Progress, recording
from hw_sim.stage import Stage
from hw_sim.unit import Unit, UnitConfig

COLUMNS, ROWS, PITCH_MM = 6, 5, 28.0
"""The grid of Fig. 3.24 over the area of App. A.1: 140 × 112 mm around the middle."""

STAGE_STREAM = 6
"""Keeps the stage's random numbers apart from those of the frames."""

LED_REFERENCE = (False, True, False, True)
"""The frame LEDs in the exposures before the grid, with the beam in the middle."""


def grid_mm(pitch_mm: float = PITCH_MM) -> list[tuple[float, float]]:
    """The nodes (x, y) of the scan in mm, row by row from the smallest x and y."""
    return [
        ((column - (COLUMNS - 1) / 2.0) * pitch_mm, (row - (ROWS - 1) / 2.0) * pitch_mm)
        for row in range(ROWS)
        for column in range(COLUMNS)
    ]


def record_scan(
    folder: Path, unit: Unit, stage: Stage, exposures: int, progress: Progress, pitch_mm: float = PITCH_MM
) -> None:
    """Write the scan of a unit into ``folder``: LED reference pairs, then ``exposures`` a node."""
    nodes = grid_mm(pitch_mm)
    planned = len(LED_REFERENCE) + len(nodes) * exposures
    with recording(folder, unit, "scan", planned, progress) as recorder:
        for leds_on in LED_REFERENCE:
            recorder.expose(BeamPose(0.0, 0.0), leds_on=leds_on)
        for node in nodes:
            pose = stage.place(*node)
            for _ in range(exposures):
                recorder.expose(pose, stage_mm=node)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What the scan takes on the command line."""
    add_common_arguments(parser)
    parser.add_argument("--exposures", type=at_least_one, default=2, help="exposures a node (default 2)")
    parser.add_argument(
        "--stage", action="store_true", help="in real time: `altd scan` drives a simulated Grbl stage"
    )


def run(arguments: argparse.Namespace) -> int:
    """Record a scan; raises BadInputError."""
    if arguments.stage:
        from hw_sim.staged_scan import staged_scan

        return staged_scan(arguments.output, arguments.seed, arguments.exposures)
    unit = Unit(UnitConfig(seed=arguments.seed))
    stage = Stage(np.random.default_rng([arguments.seed, STAGE_STREAM]))
    record_scan(arguments.output, unit, stage, arguments.exposures, terminal_progress("scan"))
    return 0
