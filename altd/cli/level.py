"""``altd level``: finds the zeros and directions of the inclinometer's axes in the unit."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from altd.cli.arguments import DEFAULT_CONFIG, add_config, add_output
from altd.errors import BadInputError
from altd.process.standard_streams import print_errors, print_lines

SUMMARY = "level the inclinometer: its zeros and axes, from positions of known tilt"
_MAX_DEG, _FULL_TURN_DEG = 45.0, 360.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_config(parser)
    add_output(parser, "FILE", "file of the levelling, for `[inclinometer] level`")
    parser.add_argument(
        "--at",
        type=_position,
        action="append",
        metavar="ROLL,PITCH[,TURNED]",
        help="a position: tilt of the plate below the unit, and by how much the unit is turned on it, "
        "counterclockwise from above, degrees (default: 0,0 and 0,0,180)",
    )
    parser.add_argument(
        "--sigma-deg",
        type=float,
        required=True,
        metavar="U",
        help="standard uncertainty of the plate's tilt, of roll and pitch each",
    )
    parser.add_argument("--by", default="", metavar="NAME", help="who levels; kept in the file")


def _position(text: str) -> tuple[float, float, float]:
    parts = [float(part) for part in text.split(",")]
    roll_deg, pitch_deg, turned_deg = parts if len(parts) > 2 else (*parts, 0.0)
    if not (max(abs(roll_deg), abs(pitch_deg)) <= _MAX_DEG and abs(turned_deg) <= _FULL_TURN_DEG):
        raise ValueError
    return roll_deg, pitch_deg, turned_deg


def run(options: argparse.Namespace) -> int:
    """Guide through the positions, and write the file."""
    from altd.app.level import report, save_level, take_level
    from altd.app.settings import load_beam_settings

    place = Path(options.config or DEFAULT_CONFIG)
    config = load_beam_settings(place)
    if config.inclinometer is None:
        raise BadInputError(place, "there is no table [inclinometer]")
    if not 0.0 < options.sigma_deg <= 10.0:
        raise BadInputError("--sigma-deg", f"{options.sigma_deg:g} is not possible; possible: above 0 to 10")
    plan = options.at or [(0.0, 0.0, 0.0), (0.0, 0.0, 180.0)]
    if len(plan) not in range(2, 21):
        raise BadInputError("--at", f"{len(plan)} positions are not possible; possible: 2 to 20")

    def ask(number: int) -> None:
        roll_deg, pitch_deg, turned_deg = plan[number]
        print_errors(
            f"altd level: position {number + 1} of {len(plan)}: roll {roll_deg:g} deg, "
            f"pitch {pitch_deg:g} deg, turned by {turned_deg:g} deg; Enter when it rests"
        )
        if not sys.stdin.readline():
            raise BadInputError("standard input", "ended before all positions were read; nothing is written")

    settings = config.inclinometer
    document = take_level(
        settings.inclinometer(), settings, config.unit.serial, plan, options.sigma_deg, options.by, ask
    )
    try:
        alignment = document.alignment()
    except ValueError as error:
        raise BadInputError(options.output, f"not written: {error}") from error
    save_level(document, options.output)
    for line in report(alignment):
        print_lines(line)
    return 0
