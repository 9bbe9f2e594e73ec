"""``python -m hw_sim chain``: record scans of a row of glass targets, and rounds in which a place moves."""

import argparse
import json
import math
from pathlib import Path

from altd.errors import BadInputError
from altd.files.writing import write_file
from hw_sim.arguments import at_least_one, natural
from hw_sim.beam import BeamPose
from hw_sim.row.record import SETTLE_S, record_rounds, record_scans
from hw_sim.row.row import FPS, Row, RowConfig

EXPOSURES = 4
STEP_MM = (0.32, -0.24)
"""Displacement of t3 (x, y) in the middle of the rounds, mm."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of the row."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="new or empty folder")
    parser.add_argument("--seed", type=natural, default=1, help="selects the row (default: 1)")
    parser.add_argument("--rounds", type=at_least_one, default=16, help="rounds (default: 16)")
    parser.add_argument(
        "--stuck",
        default="",
        metavar="NAME=STATE",
        help="a glass that is stuck, such as t3=opaque or t3=clear",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write scans, rounds, truth and settings; raises BadInputError."""
    folder: Path = arguments.output
    rounds: int = arguments.rounds
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BadInputError(folder, "exists and is not an empty folder")
    config = RowConfig(seed=arguments.seed)
    round_s = len(config.names) * (SETTLE_S + EXPOSURES / FPS)
    moving = RowConfig(
        seed=arguments.seed,
        beam=lambda t_s: _drifting(t_s / (rounds * round_s)),
        places={"t3": lambda t_s: STEP_MM if t_s >= rounds // 2 * round_s - 0.01 else (0.0, 0.0)},
        stuck=_stuck(arguments.stuck, config.names),
    )
    record_scans(folder, Row(config))
    truth = record_rounds(folder / "rounds", Row(moving), rounds, EXPOSURES)
    write_file(folder / "truth.json", (json.dumps(truth, indent=1) + "\n").encode())
    write_file(folder / "altd.toml", _settings(config).encode())
    return 0


def _drifting(share: float) -> BeamPose:
    """Pose of a beam that drifts by 2 mm and 0.1 mrad in x, and by half of that in y."""
    way = 0.5 - 0.5 * math.cos(math.pi * share)
    return BeamPose(2.0 * way, way, 1e-4 * way, 0.5e-4 * way)


def _stuck(text: str, names: tuple[str, ...]) -> dict[str, str]:
    """Parse the name of a glass and the state in which it is stuck."""
    if not text:
        return {}
    name, _, state = text.partition("=")
    if name not in names or state not in ("opaque", "clear"):
        raise BadInputError(
            "--stuck", f"{text!r} is not possible; possible: {names[0]}=opaque to {names[-1]}=clear"
        )
    return {name: state}


def _settings(config: RowConfig) -> str:
    """Text of ``altd.toml`` for the row."""
    text = f'[unit]\nserial = "{config.serial}"\ncalibration = "chain.json"\ninstrument = "chain"\n\n'
    text += f'[chain]\nstable = ["{config.names[0]}", "{config.names[-1]}"]\nalarm_mm = 0.3\n'
    for name, z_mm in zip(config.names, config.z_mm, strict=True):
        text += f'\n[[targets]]\nname = "{name}"\nz_mm = {z_mm}\ncamera = "{name}"\n'
        text += f'\n[cameras.{name}]\ndriver = "recording"\npath = "rounds"\n'
    return text
