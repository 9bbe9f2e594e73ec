"""``altd map``: converts px to mm."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.process.standard_streams import print_errors

SUMMARY = "convert px to mm: reads lines 'u v' from standard input"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "--calibration", type=Path, required=True, metavar="FILE", help="calibration of the unit"
    )
    parser.add_argument("--target", required=True, metavar="NAME", help="target whose camera has the pixels")
    parser.add_argument(
        "--format",
        choices=("jsonl", "csv"),
        help="output format (default: lines 'x_mm y_mm sigma_x_mm sigma_y_mm')",
    )


def run(options: argparse.Namespace) -> int:
    """Write one row per line of standard input."""
    from altd.answers.map import answer

    return answer(
        options.calibration, options.target, options.format, lambda line: print_errors(f"altd map: {line}")
    )
