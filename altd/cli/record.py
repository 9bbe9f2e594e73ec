"""``altd record``: frames kept for replay."""

from __future__ import annotations

import argparse
import asyncio
import logging

from altd.cli.options import add_config, add_output, progress_on
from altd.process.endings import EndedBySignal, until_signal
from altd.process.logs import logging_to_stderr
from altd.process.standard_streams import complain

SUMMARY = "keep frames for replay"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    add_config(parser)
    add_output(parser, "DIR")
    parser.add_argument("--seconds", type=_seconds, required=True, metavar="S")
    parser.add_argument(
        "--kind",
        choices=("measurement", "flat", "self-check"),
        default="measurement",
        help="what it shows (measurement)",
    )


def run(options: argparse.Namespace) -> int:
    """Record; interrupted, say what is kept."""
    from altd.app.record import record_of
    from altd.app.settings import load_settings
    from altd.ports import CameraError, LampsError
    from altd.records import counted

    config = load_settings(options.config)
    show, kept = progress_on("exposures"), 0

    def progress(done: int, planned: int) -> None:
        nonlocal kept
        kept = done
        show(done, planned)

    with logging_to_stderr(logging.WARNING):
        work = record_of(config, options.config, options.output, options.seconds, options.kind, progress)
        try:
            exposures = asyncio.run(until_signal(work))
        except EndedBySignal:
            complain(
                f"altd record: interrupted: {counted(kept, 'exposure')} in {options.output}"
                if kept
                else "altd record: interrupted before the first exposure"
            )
            raise
        except (LampsError, CameraError) as error:
            complain(f"altd record: {error}")
            return 1
    complain(f"{counted(exposures, 'exposure')} in {options.output}")
    return 0


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value <= 86_400:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds up to one day")
    return value
