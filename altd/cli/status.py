"""``altd status``: prints the state of the unit, as reported by its running daemon."""

from __future__ import annotations

import argparse
import json
import sys

from altd.cli.arguments import add_socket, socket_of
from altd.errors import shown_in
from altd.process.standard_streams import print_errors, print_lines

SUMMARY = "print values, state, causes and remedies of the running daemon"

_TIMEOUT_S = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_socket(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def run(options: argparse.Namespace) -> int:
    """Print one screen of text; return 0 if it measures and is good or needs maintenance, otherwise 1."""
    from altd.app.ask_daemon import RunningDaemon
    from altd.local_socket import NoAnswerError
    from altd.terminal.lines import is_healthy, status_text

    daemon = RunningDaemon(socket_of(options), _TIMEOUT_S)
    try:
        reading, measurement = daemon.reading()
        status, status_document = daemon.status()
        check, check_document = daemon.self_check()
        calibration, calibration_document = daemon.calibration()
    except NoAnswerError as error:
        print_errors(f"altd status: {error}")
        return 1
    if options.json:
        documents = {
            "measurement": measurement,
            "status": status_document,
            "self_check": check_document,
            "calibration": calibration_document,
        }
        text = json.dumps(documents)
    else:
        text = shown_in(sys.stdout.encoding or "ascii", status_text(reading, status, check, calibration))
    print_lines(*text.split("\n"))
    return 0 if is_healthy(reading, status) else 1
