"""``altd scan``: records a calibration scan with the stage, or a flat with the laser."""

from __future__ import annotations

import argparse
import asyncio
import logging
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from altd.cli.arguments import add_config, add_output
from altd.errors import one_line
from altd.process.endings import EndedBySignal, until_signal
from altd.process.logs import logging_to_stderr
from altd.process.standard_streams import print_errors

if TYPE_CHECKING:
    from altd.acquisition.scan.scanner import Scanner

SUMMARY = "record a calibration scan with the stage; continue one that was interrupted"
_BAR_LETTERS = 24


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_config(parser)
    add_output(parser, "DIR", "folder of the recording")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--flat",
        action="store_true",
        help="a flat made with the laser, for altd calibrate --flat: an exposure each flat_pitch_mm",
    )
    kind.add_argument("--turned", action="store_true", help="the unit is turned by 180°: the second scan")
    kind.add_argument(
        "--no-turn",
        action="store_true",
        help="do not ask for the second scan, which shows the direction of the calibrating beam",
    )


def run(options: argparse.Namespace) -> int:
    """Scan with the config's stage and cameras."""
    from altd.acquisition.scan.plan import Raster
    from altd.app.record import scanner_of
    from altd.app.settings import load_beam_settings

    screen = ScanScreen()
    with logging_to_stderr(logging.ERROR):
        config = load_beam_settings(options.config)
        if options.flat:
            config = config.model_copy(update={"scan": Raster.over(config.scan)})
        turned = config.model_copy(update={"scan": config.scan.model_copy(update={"turned_deg": 180})})
        if options.turned:
            config = turned
        scanner = scanner_of(config, options.config, options.output, screen)
        status = run_scan(scanner, options.output, screen)
        is_of_verification = config.scan.deflection_yaw_deg or config.scan.deflection_pitch_deg
        if status or options.flat or options.no_turn or config.scan.turned_deg or is_of_verification:
            return status
        second = options.output.with_name(f"{options.output.name}-turned")
        screen.report(
            "a second scan shows the direction of the calibrating beam: leave stage and laser as they are, "
            f"turn the unit by 180° in its seat, and record it by altd scan --turned -o {second}"
        )
        if not sys.stdin.isatty() or not _is_turned():
            return status
        return run_scan(scanner_of(turned, options.config, second, screen), second, screen)


def _is_turned() -> bool:
    """Ask whether the unit is turned; the end of input counts as no."""
    try:
        return not input("Enter when it is turned, n for no second scan: ").strip()
    except EOFError:
        return False


def run_scan(scanner: Scanner, output: Path, screen: ScanScreen) -> int:
    """Scan until done, stopped or interrupted; report how it ended, and return the exit status."""
    from altd.acquisition.scan.scanner import ScanStoppedError

    again = "the same command continues there"
    try:
        result = asyncio.run(until_signal(scanner.run()))
    except ScanStoppedError as error:
        screen.report(f"stopped: {error}; {again}")
        return 1
    except EndedBySignal:
        screen.report(f"interrupted; {again}")
        raise
    finally:
        screen.clear()
    for line in result.refused:
        screen.report(f"without {line}")
    screen.report(f"{result.exposures} exposures in {output}")
    return 0


class ScanScreen:
    """See ``altd.acquisition.scan.scanner.ProgressReporter``; ``name`` is the prefix of permanent lines."""

    def __init__(self, name: str = "altd scan") -> None:
        self._name = name
        self._terminal = sys.stderr.isatty()
        self._first: tuple[float, int] | None = None

    def report(self, line: str) -> None:
        """Print a line of its own, above the bar."""
        self.clear()
        print_errors(f"{self._name}: {line}")

    def progress(self, done: int, total: int, doing: str) -> None:
        """Redraw the bar; do nothing in a pipe."""
        if not self._terminal:
            return
        bar = ("#" * (_BAR_LETTERS * done // total)).ljust(_BAR_LETTERS, ".")
        line = f"[{bar}] {done}/{total} nodes{self._left(done, total)}  {doing}"
        width = shutil.get_terminal_size().columns - 1
        sys.stderr.write(f"\r{one_line(line)[:width]}\033[K")
        sys.stderr.flush()

    def clear(self) -> None:
        """Remove the bar."""
        if self._terminal:
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()

    def _left(self, done: int, total: int) -> str:
        """Text with the remaining time for the other nodes at the pace of this run."""
        now = time.monotonic()
        if self._first is None or done <= self._first[1]:
            self._first = now, done
            return ""
        since, at_first = self._first
        left_s = round((now - since) / (done - at_first) * (total - done))
        return f", {left_s // 60}:{left_s % 60:02d} left"
