"""``python -m hw_sim flat``: the targets in even light or under the laser's own spot, and in the dark."""

import argparse
import math
from pathlib import Path

import numpy as np

from hw_sim.arguments import add_common_arguments, at_least_one, terminal_progress
from hw_sim.beam import BeamPose
from hw_sim.faults import Fault
from hw_sim.recording import Progress, recording
from hw_sim.scan import STAGE_STREAM, USUAL
from hw_sim.stage import Stage
from hw_sim.unit import Unit, UnitConfig

EVEN_MW_PER_MM2 = 0.03
"""Irradiance that brings the ink of the window and the plate to more than half of full scale."""

RASTER_PITCH_MM = 2.5
"""A quarter of a spot of 12 × 11 mm: the light of four spots' centres falls on each pixel."""
_REACH_DIAMETERS = 0.75
"""Reach of the raster beyond the scan's nodes; the light around the outer nodes is then even too."""


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


def record_laser_flat(
    folder: Path, unit: Unit, stage: Stage, pitch_mm: float, frame_sets: int, progress: Progress
) -> None:
    """Write ``frame_sets`` in the dark, then one for each position of the laser's spot, into ``folder``.

    The stage moves the spot over the area of the usual scan and the reach of its outermost spots, row by row
    and back, in steps of at most ``pitch_mm``.
    """
    nodes = raster_mm(pitch_mm, _REACH_DIAMETERS * max(unit.config.laser.diameters_mm))
    with recording(folder, unit, "flat", frame_sets + len(nodes), progress) as recorder:
        unit.inject(Fault.NO_LASER)
        for _ in range(frame_sets):
            recorder.expose(BeamPose(0.0, 0.0))
        unit.clear(Fault.NO_LASER)
        for node in nodes:
            recorder.expose(stage.place(*node), stage_mm=node)


def raster_mm(pitch_mm: float, beyond_mm: float) -> list[tuple[float, float]]:
    """Positions (x, y) of a raster in mm: over the usual scan's nodes and ``beyond_mm`` on each side."""
    along_x, along_y = (
        np.linspace(-half_mm, half_mm, math.ceil(2 * half_mm / pitch_mm) + 1)
        for half_mm in ((lines - 1) / 2 * USUAL.pitch_mm + beyond_mm for lines in (USUAL.columns, USUAL.rows))
    )
    return [
        (float(x_mm), float(y_mm))
        for number, y_mm in enumerate(along_y)
        for x_mm in (along_x if number % 2 == 0 else along_x[::-1])
    ]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of the flat field."""
    add_common_arguments(parser)
    parser.add_argument(
        "--exposures",
        type=at_least_one,
        default=20,
        help="dark exposures, and as many in even light (default: 20)",
    )
    parser.add_argument(
        "--laser", action="store_true", help="carry the laser's spot over the targets in place of even light"
    )
    parser.add_argument(
        "--pitch",
        type=_pitch_mm,
        default=RASTER_PITCH_MM,
        metavar="MM",
        help=f"steps of the laser's spot (default: {RASTER_PITCH_MM})",
    )


def run(arguments: argparse.Namespace) -> int:
    """Record a flat field; raises BadInputError."""
    unit = Unit(UnitConfig(seed=arguments.seed, hard=arguments.hard))
    progress = terminal_progress("flat")
    if not arguments.laser:
        record_flat(arguments.output, unit, arguments.exposures, progress)
        return 0
    stage = Stage(np.random.default_rng([arguments.seed, STAGE_STREAM, 1]))
    record_laser_flat(arguments.output, unit, stage, arguments.pitch, arguments.exposures, progress)
    return 0


def _pitch_mm(text: str) -> float:
    """Parse a pitch of at least half a millimetre, which makes a hundred thousand exposures."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.5 <= value <= 20.0:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a pitch from 0.5 to 20 mm")
    return value
