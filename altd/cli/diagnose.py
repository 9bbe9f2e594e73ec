"""``altd diagnose``: writes the diagnostics of a unit into one archive, without its page."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.cli.arguments import add_config
from altd.process.standard_streams import print_errors, print_lines

SUMMARY = "write an archive for remote diagnostics, also while the daemon does not run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_config(parser)
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="archive to write (default: altd-SERIAL-TIME.zip)"
    )


def run(options: argparse.Namespace) -> int:
    """Write the archive; if the daemon does not answer, from its files."""
    from altd.app.diagnostics import diagnose
    from altd.files.writing import write_file

    name, content, why = diagnose(options.config)
    if why:
        print_errors(f"altd diagnose: {why}: only its files are in the archive")
    write_file(output := options.output or Path(name), content)
    print_lines(str(output))
    return 0
