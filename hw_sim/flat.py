"""``python -m hw_sim flat``: the targets in even light and in the dark, recorded."""

from __future__ import annotations

import argparse
from pathlib import Path

from hw_sim.arguments import add_common_arguments, at_least_one, terminal_progress
from hw_sim.beam import BeamPose
from hw_sim.faults import Fault
from hw_sim.recording import Progress, recording
from hw_sim.unit import Unit, UnitConfig

EVEN_MW_PER_MM2 = 0.03
"""Brings the ink of the window and the plate to more than half of full scale."""


def record_flat(folder: Path, unit: Unit, frame_sets: int, progress: Progress) -> None:
    """Write ``frame_sets`` in the dark and as many in even light into ``folder``; the laser is off."""
    unit.inject(Fault.NO_LASER)
    try:
        with recording(folder, unit, "flat", 2 * frame_sets, progress) as recorder:
            for even in (0.0, EVEN_MW_PER_MM2):
                for _ in range(frame_sets):
                    recorder.expose(BeamPose(0.0, 0.0), even_mw_per_mm2=even)
    finally:
        unit.clear(Fault.NO_LASER)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the flat field on the command line."""
    add_common_arguments(parser)
    parser.add_argument(
        "--exposures",
        type=at_least_one,
        default=20,
        help="lit exposures, and as many dark ones (default: 20)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Record a flat field; raises BadInputError."""
    unit = Unit(UnitConfig(seed=arguments.seed, hard=arguments.hard))
    record_flat(arguments.output, unit, arguments.exposures, terminal_progress("flat"))
    return 0
