"""``altd locate``: finds the spot in images."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.process.standard_streams import print_errors

SUMMARY = "find the laser spot in pictures with two localisers"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("images", type=Path, nargs="+", metavar="IMAGE", help="picture file")
    parser.add_argument(
        "--format", choices=("jsonl", "csv"), default="jsonl", help="output format (default: jsonl)"
    )


def run(options: argparse.Namespace) -> int:
    """Write one row per image; return 2 if one could not be read."""
    from altd.answers.locate import answer

    return answer(options.images, options.format, lambda line: print_errors(f"altd locate: {line}"))
