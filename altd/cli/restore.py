"""``altd restore``: restores the unit of a backup on this computer."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.cli.arguments import DEFAULT_CONFIG
from altd.process.standard_streams import print_lines

SUMMARY = "restore an archive of `altd backup`; the daemon must be stopped"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("archive", type=Path, metavar="FILE", help="archive of `altd backup`")
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        default=DEFAULT_CONFIG,
        help=f"place of the settings (default: {DEFAULT_CONFIG})",
    )


def run(options: argparse.Namespace) -> int:
    """Check the archive, then replace the files."""
    from altd.app.restore import restore

    serial = restore(options.archive, options.config)
    print_lines(f"{options.config}: unit {serial} is restored; altd check-config and altd doctor check it")
    return 0
