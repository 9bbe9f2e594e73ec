"""``altd replay``: a recording, measured."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.cli.options import progress_on
from altd.process.standard_streams import complain

SUMMARY = "measure a recording: a JSON object a line, a table, a plot"
_MAX_EXPOSURES = 1000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    parser.add_argument("recording", type=Path, metavar="RECORDING")
    parser.add_argument("--calibration", type=Path, required=True, metavar="FILE")
    parser.add_argument(
        "--window", type=_count, metavar="N", help="exposures averaged (20; of a scan all of a node)"
    )
    parser.add_argument("--every", type=_count, metavar="N", help="a line after so many (1)")
    parser.add_argument("--format", choices=("jsonl", "csv", "parquet"), default="jsonl", help="(jsonl)")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="into a file instead of on stdout")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="values over time and reasons, as SVG")


def run(options: argparse.Namespace) -> int:
    """Write what was measured."""
    from altd.answers.replay import Question, answer

    question = Question(
        options.recording,
        options.calibration,
        options.window,
        options.every,
        options.format,
        options.output,
        options.plot,
    )
    into_file = options.output is not None
    progress = progress_on("frames") if into_file else lambda done, total: None
    answer(question, lambda line: complain(f"altd replay: {line}"), progress)
    return 0


def _count(text: str) -> int:
    value = int(text) if text.isdecimal() and len(text) < 9 else 0
    if not 1 <= value <= _MAX_EXPOSURES:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number from 1 to {_MAX_EXPOSURES}")
    return value
