"""``altd backup``: settings, calibration, credentials and history in one archive."""

from __future__ import annotations

import argparse
import os
from datetime import UTC, datetime
from pathlib import Path

from altd.cli.arguments import add_config
from altd.process.standard_streams import print_errors, print_lines

SUMMARY = "write settings, calibration, credentials, self-check state and history into one archive"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_config(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="archive to write (default: altd-backup-TIME.tar.gz)",
    )


def run(options: argparse.Namespace) -> int:
    """Write the archive, and report what it lacks."""
    from altd.app.backup import back_up

    os.nice(10)  # the daemon on the same computer continues measuring
    output = options.output or Path(f"altd-backup-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.tar.gz")
    left_out = back_up(options.config, output)
    for line in left_out:
        print_errors(f"altd backup: {line}")
    print_lines(f"{output}: contains passwords and keys: keep it where only administrators can read it")
    return 1 if left_out else 0
