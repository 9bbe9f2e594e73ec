"""``python -m hw_sim scan``: record the calibration scan of Sec. 3.5.7."""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from altd.errors import BadInputError
from hw_sim.arguments import add_common_arguments, at_least_one, terminal_progress
from hw_sim.beam import BeamPose
from hw_sim.recording import Progress, recording
from hw_sim.stage import ADJUSTED, MISALIGNED, Stage
from hw_sim.unit import CAMERAS, FRONT, Unit, UnitConfig


@dataclass(frozen=True, slots=True)
class Grid:
    """Nodes of a scan, around the middle of the targets; by default the grid of Fig. 3.24.

    The default covers 140 × 112 mm, the area of App. A.1.
    """

    pitch_mm: float = 28.0
    columns: int = 6
    rows: int = 5

    def nodes_mm(self) -> list[tuple[float, float]]:
        """Nodes (x, y) in mm, row by row from the smallest x and y."""
        return [
            (
                (column - (self.columns - 1) / 2.0) * self.pitch_mm,
                (row - (self.rows - 1) / 2.0) * self.pitch_mm,
            )
            for row in range(self.rows)
            for column in range(self.columns)
        ]


USUAL = Grid()

STAGE_STREAM = 6
"""Separate random stream for the stage, apart from that of the frames."""

SETTLED_S = 10.0
"""Time that a switched glass has had to settle at a node."""

LED_REFERENCE = (False, True, False, True)
"""State of the frame LEDs in the frame sets before the grid, with the beam in the middle."""


def dense_grid(columns: int, rows: int) -> Grid:
    """Grid of this size with the widest pitch at which it is within the usual grid."""
    columns_share, rows_share = (USUAL.columns - 1) / (columns - 1), (USUAL.rows - 1) / (rows - 1)
    return Grid(USUAL.pitch_mm * min(columns_share, rows_share), columns, rows)


def record_scan(
    folder: Path, unit: Unit, stage: Stage, frame_sets: int, progress: Progress, grid: Grid = USUAL
) -> None:
    """Write the scan of a unit into ``folder``: LED reference pairs, then ``frame_sets`` for each node.

    For a unit with a switched front target, front and rear target are exposed one after the other.
    """
    nodes, glass = grid.nodes_mm(), unit.glass
    shown = [CAMERAS] if glass is None else [(camera,) for camera in CAMERAS]
    planned = len(LED_REFERENCE) + len(nodes) * frame_sets * len(shown)
    with recording(folder, unit, "scan", planned, progress, stage.header()) as recorder:
        for leds_on in LED_REFERENCE:
            recorder.expose(BeamPose(0.0, 0.0), leds_on=leds_on)
        for node in nodes:
            pose = stage.place(*node)
            for cameras in shown:
                if glass is not None:
                    glass.switch(FRONT in cameras, recorder.t_ns * 1e-9 - SETTLED_S)
                for _ in range(frame_sets):
                    recorder.expose(pose, stage_mm=node, cameras=cameras)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of the scan."""
    add_common_arguments(parser)
    parser.add_argument("--exposures", type=at_least_one, default=2, help="exposures per node (default: 2)")
    parser.add_argument(
        "--grid",
        type=_grid,
        default=USUAL,
        metavar="C,R",
        help="columns and rows of nodes on the same area (default: 6,5)",
    )
    parser.add_argument(
        "--misaligned",
        action="store_true",
        help="stage 120 ppm long and 0.2 mrad out of square, beam tilted by 0.8 and 0.47 mm/m",
    )
    parser.add_argument(
        "--turned", action="store_true", help="the unit is turned by 180° about z; stage and beam do not move"
    )
    parser.add_argument(
        "--stage", action="store_true", help="scan in real time, as `altd scan` does with a Grbl stage"
    )


def run(arguments: argparse.Namespace) -> int:
    """Record a scan; raises BadInputError."""
    if arguments.stage:
        from hw_sim.staged_scan import staged_scan

        if arguments.grid != USUAL:
            raise BadInputError("--grid", "goes without --stage: what altd scan makes is its own grid")
        if arguments.misaligned or arguments.turned:
            raise BadInputError("--misaligned, --turned", "go without --stage: its table is adjusted")
        return staged_scan(arguments.output, arguments.seed, arguments.exposures, arguments.hard)
    unit = Unit(UnitConfig(seed=arguments.seed, hard=arguments.hard))
    mounting = replace(MISALIGNED if arguments.misaligned else ADJUSTED, is_turned=arguments.turned)
    stage = Stage(
        np.random.default_rng([arguments.seed, STAGE_STREAM + mounting.is_turned]), mounting=mounting
    )
    progress = terminal_progress("scan")
    record_scan(arguments.output, unit, stage, arguments.exposures, progress, arguments.grid)
    return 0


def _grid(text: str) -> Grid:
    """Parse columns and rows of a dense grid."""
    try:
        columns, rows = (int(part) for part in text.split(","))
    except ValueError:
        columns = rows = 0
    if not 4 <= min(columns, rows) <= max(columns, rows) <= 200:
        raise argparse.ArgumentTypeError(f"{text!r} is not a grid such as 6,5: 4 to 200 columns and rows")
    return dense_grid(columns, rows)
