"""``altd scan``: a calibration scan with the stage, or a flat made with the laser."""

from __future__ import annotations

import argparse
import asyncio
import logging
from pathlib import Path
from typing import TYPE_CHECKING

from altd.cli.options import add_config, add_output
from altd.process.endings import EndedBySignal, until_signal
from altd.process.logs import logging_to_stderr

if TYPE_CHECKING:
    from altd.acquisition.scan.scanner import Scanner
    from altd.cli.scan_screen import ScanScreen

SUMMARY = "record a calibration scan with the stage; continue one that was interrupted"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    add_config(parser)
    add_output(parser, "DIR", "folder of the recording")
    parser.add_argument(
        "--flat",
        action="store_true",
        help="a flat made with the laser, for altd calibrate --flat: an exposure each flat_pitch_mm",
    )


def run(options: argparse.Namespace) -> int:
    """Scan with the config's stage and cameras."""
    from altd.acquisition.scan.plan import Raster
    from altd.app.record import scanner_of
    from altd.app.settings import load_beam_settings
    from altd.cli.scan_screen import ScanScreen

    screen = ScanScreen()
    with logging_to_stderr(logging.ERROR):
        config = load_beam_settings(options.config)
        if options.flat:
            config = config.model_copy(update={"scan": Raster.over(config.scan)})
        scanner = scanner_of(config, options.config, options.output, screen)
        return run_scan(scanner, options.output, screen)


def run_scan(scanner: Scanner, output: Path, screen: ScanScreen) -> int:
    """Scan until done, stopped or interrupted, and say how it ended; the exit status."""
    from altd.acquisition.scan.scanner import ScanStoppedError

    again = "the same command continues there"
    try:
        result = asyncio.run(until_signal(scanner.run()))
    except ScanStoppedError as error:
        screen.say(f"stopped: {error}; {again}")
        return 1
    except EndedBySignal:
        screen.say(f"interrupted; {again}")
        raise
    finally:
        screen.clear()
    for line in result.refused:
        screen.say(f"without {line}")
    screen.say(f"{result.exposures} exposures in {output}")
    return 0
