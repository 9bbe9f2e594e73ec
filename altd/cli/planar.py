"""``altd planar``: calibrates a planar 3-PRP machine."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.cli.arguments import progress_on
from altd.process.standard_streams import print_errors, print_lines

SUMMARY = "calibrate a planar machine from recorded poses; print its geometry, workspace and singular poses"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "recordings",
        type=Path,
        nargs="+",
        metavar="RECORDING",
        help="folder of a recording of kind `planar` whose rows state the joints",
    )
    parser.add_argument(
        "--calibration", type=Path, required=True, metavar="FILE", help="calibration of the unit"
    )
    parser.add_argument(
        "--design", type=Path, required=True, metavar="FILE", help="design of the machine, TOML"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="also write the output into FILE")


def run(options: argparse.Namespace) -> int:
    """Print the calibrated machine; write it if a file is named."""
    from altd.answers.planar import planar
    from altd.files.writing import check_replaceable, write_file

    if options.output is not None:
        check_replaceable(options.output)
    files = options.recordings, options.calibration, options.design
    lines = list(planar(*files, lambda said: print_errors(f"altd planar: {said}"), progress_on("frames")))
    if options.output is not None:
        write_file(options.output, "".join(f"{line}\n" for line in lines).encode())
    print_lines(*lines)
    return 0
