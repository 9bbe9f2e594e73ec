"""``altd selfcheck``: checks whether cameras and targets are where they were calibrated."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from altd.cli.arguments import DEFAULT_CONFIG
from altd.errors import BadInputError, shown_in
from altd.process.standard_streams import print_errors, print_lines

SUMMARY = "check that each camera is where it was calibrated: a running unit, or a recording"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "recording",
        type=Path,
        nargs="?",
        metavar="RECORDING",
        help="recording of the frame LEDs; needs --calibration",
    )
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="calibration to compare the recording with"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        default=argparse.SUPPRESS,  # a recording needs none, not even that of the service
        help=f"settings of the daemon that checks itself now (default: {DEFAULT_CONFIG})",
    )


def run(options: argparse.Namespace) -> int:
    """Print the verdict with its parts; return 0 if good, 1 if not."""
    from altd.local_socket import NoAnswerError
    from altd.terminal.documents import SelfCheckDocument, checked
    from altd.terminal.lines import self_check_table

    try:
        document = _document(options)
        check = checked(SelfCheckDocument, document)
    except NoAnswerError as error:
        print_errors(f"altd selfcheck: {error}")
        return 1
    except ValueError as error:
        print_errors(f"altd selfcheck: the answer is not a self-check: {error}")
        return 1
    if options.json:
        print_lines(json.dumps(document))
    else:
        print_lines(*(shown_in(sys.stdout.encoding or "ascii", line) for line in self_check_table(check)))
    return 0 if check.verdict == "good" else 1


def _document(options: argparse.Namespace) -> dict[str, Any]:
    if options.recording is None:
        return _ask_daemon(options)
    if "config" in options:
        raise BadInputError("--config", "asks the running daemon: it cannot be combined with RECORDING")
    if options.calibration is None:
        raise BadInputError(options.recording, "missing: --calibration FILE, to compare the recording with")
    from altd.answers.selfcheck import judge_recording

    return judge_recording(options.recording, options.calibration)


def _ask_daemon(options: argparse.Namespace) -> dict[str, Any]:
    """Request a self-check from the running daemon."""
    if options.calibration is not None:
        raise BadInputError("--calibration", "missing: RECORDING, which it requires")
    if "config" not in options and not DEFAULT_CONFIG.is_file():
        raise BadInputError("RECORDING", f"missing, or --config FILE, because there is no {DEFAULT_CONFIG}")
    from altd.app.ask_daemon import ask_running_daemon
    from altd.app.settings import load_settings

    place = options.config if "config" in options else DEFAULT_CONFIG
    return ask_running_daemon(load_settings(place), place)
