"""``altd events``: prints events of the unit from its history."""

from __future__ import annotations

import argparse

from altd.cli.arguments import add_history, add_span, history_of, span_of

SUMMARY = "print the events of the history: states, causes, self-checks, starts, changes, requests"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_history(parser)
    add_span(parser)
    parser.add_argument(
        "--kind",
        action="append",
        default=[],
        metavar="KIND",
        help="events of this kind; can be repeated (default: all)",
    )
    parser.add_argument(
        "--format", choices=("text", "csv", "jsonl"), default="text", help="output format (default: text)"
    )
    parser.add_argument("--follow", action="store_true", help="continue with new events until Ctrl-C")


def run(options: argparse.Namespace) -> int:
    """Write one line per event, in the order of their occurrence."""
    from altd.answers.events import answer

    kinds = tuple(options.kind)
    answer(history_of(options), span_of(options), kinds, options.format, follow=options.follow)
    return 0
