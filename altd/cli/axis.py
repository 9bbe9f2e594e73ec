"""``altd axis``: points of the machine against the designed axis."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.cli.arguments import add_config
from altd.process.standard_streams import print_errors

SUMMARY = "put the machine's points into the project and compare them with the designed axis"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("axis", type=Path, metavar="AXIS", help="designed axis, JSON")
    parser.add_argument("beam", type=Path, metavar="BEAM", help="surveyed beam, JSON")
    parser.add_argument(
        "measurements",
        type=Path,
        nargs="?",
        metavar="MEASUREMENTS",
        help="file of measurements, one JSON object a line (default: standard input)",
    )
    add_config(parser)
    parser.add_argument(
        "--format", choices=("jsonl", "csv"), default="jsonl", help="output format (default: jsonl)"
    )


def run(options: argparse.Namespace) -> int:
    """Write a row per point and measurement; return 2 if a line could not be used."""
    from altd.answers.axis import answer, guidance_of

    guidance = guidance_of(options.axis, options.beam, options.config)
    return answer(
        guidance, options.measurements, options.format, lambda line: print_errors(f"altd axis: {line}")
    )
