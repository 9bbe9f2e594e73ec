"""``altd baseline``: stores the rounds from which the displacements of a row count."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.cli.arguments import DEFAULT_CONFIG, add_config, progress_on
from altd.process.standard_streams import print_lines

SUMMARY = "store the baseline of a row of switched targets"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "recording",
        type=Path,
        nargs="?",
        metavar="RECORDING",
        help="rounds at rest (default: the recording that the settings play, or the daemon's next rounds)",
    )
    add_config(parser)
    parser.add_argument("--replace", action="store_true", help="rename an existing baseline")


def run(options: argparse.Namespace) -> int:
    """Store the baseline, or report what does."""
    from altd.app.settings import load_settings
    from altd.app.stored_baseline import store_baseline

    place = Path(options.config or DEFAULT_CONFIG)
    for line in store_baseline(
        load_settings(place), place, options.recording, options.replace, progress_on("frames")
    ):
        print_lines(line)
    return 0
