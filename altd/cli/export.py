"""``altd export``: writes measurements of the unit from its history as a table."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.cli.arguments import add_history, add_span, history_of, span_of

SUMMARY = "write the measurements of the history as a table"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_history(parser)
    add_span(parser)
    parser.add_argument(
        "--every",
        choices=("measurement", "second", "minute", "hour"),
        default="second",
        help="one row for each (default: second); measurements of the last hour, seconds of a month",
    )
    parser.add_argument(
        "--format", choices=("csv", "jsonl", "parquet"), default="csv", help="output format (default: csv)"
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="write to FILE (default: standard output)"
    )


def run(options: argparse.Namespace) -> int:
    """Write the table."""
    from altd.answers.export import answer

    answer(history_of(options), span_of(options), options.every, options.format, options.output)
    return 0
