"""``altd replay``: measures a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.cli.arguments import progress_on
from altd.process.standard_streams import print_errors

SUMMARY = "measure a recording again; write the values as JSON, table or plot"
_MAX_EXPOSURES = 1000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="folder of the recording")
    parser.add_argument(
        "--calibration", type=Path, required=True, metavar="FILE", help="calibration of the recorded unit"
    )
    parser.add_argument(
        "--config",
        type=Path,
        default=argparse.SUPPRESS,
        metavar="FILE",
        help="settings of a row of switched targets: which are stable",
    )
    parser.add_argument(
        "--window", type=_count, metavar="N", help="exposures averaged (default: 20; of a scan all of a node)"
    )
    parser.add_argument("--every", type=_count, metavar="N", help="one line per N exposures (default: 1)")
    parser.add_argument(
        "--format",
        choices=("jsonl", "csv", "parquet"),
        default="jsonl",
        help="output format (default: jsonl)",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="write to FILE (default: standard output)"
    )
    parser.add_argument(
        "--plot", type=Path, metavar="FILE", help="also plot values and reasons over time, SVG"
    )


def run(options: argparse.Namespace) -> int:
    """Measure the recording and write the results."""
    from altd.answers.replay import ReplayOptions, answer

    question = ReplayOptions(
        options.recording,
        options.calibration,
        options.window,
        options.every,
        options.format,
        options.output,
        options.plot,
        getattr(options, "config", None),
    )
    into_file = options.output is not None
    progress = progress_on("frames") if into_file else lambda done, total: None
    answer(question, lambda line: print_errors(f"altd replay: {line}"), progress)
    return 0


def _count(text: str) -> int:
    value = int(text) if text.isdecimal() and len(text) < 9 else 0
    if not 1 <= value <= _MAX_EXPOSURES:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number from 1 to {_MAX_EXPOSURES}")
    return value
