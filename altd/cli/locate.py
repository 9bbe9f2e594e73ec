"""``altd locate``: the spot in images."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.process.standard_streams import complain

SUMMARY = "find the spot in images by two localisers; one JSON object an image"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    parser.add_argument("images", type=Path, nargs="+", metavar="IMAGE")
    parser.add_argument("--format", choices=("jsonl", "csv"), default="jsonl", help="(jsonl)")


def run(options: argparse.Namespace) -> int:
    """A row an image; 2 when one could not be read."""
    from altd.answers.locate import answer

    return answer(options.images, options.format, lambda line: complain(f"altd locate: {line}"))
