"""The command line: ``altd COMMAND``. Exit status 0 good, 2 bad arguments or bad file, 1 anything else.

Each command is a module of this package with a ``SUMMARY``, ``add_arguments(parser)`` and ``run(options)``,
which returns the exit status. It imports large modules only when it runs.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from typing import Protocol

from altd import __version__
from altd.cli import (
    axis,
    backup,
    baseline,
    calibrate,
    check_config,
    devices,
    diagnose,
    doctor,
    events,
    export,
    fleet,
    ingest,
    lamps,
    level,
    locate,
    map,  # noqa: A004  the command's name
    password,
    planar,
    record,
    refraction,
    registers,
    replay,
    restore,
    run,
    scan,
    selfcheck,
    status,
    token,
    verify,
    watch,
)
from altd.cli.arguments import DEFAULT_CONFIG, Parser
from altd.process.endings import run_to_end


class Command(Protocol):
    """Interface of a command's module."""

    SUMMARY: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments of the command to the parser."""

    def run(self, options: argparse.Namespace, /) -> int:
        """Run the command; return the exit status."""


COMMANDS: dict[str, Command] = {
    "run": run,
    "calibrate": calibrate,
    "replay": replay,
    "record": record,
    "scan": scan,
    "lamps": lamps,
    "level": level,
    "locate": locate,
    "map": map,
    "axis": axis,
    "selfcheck": selfcheck,
    "verify": verify,
    "planar": planar,
    "baseline": baseline,
    "status": status,
    "watch": watch,
    "password": password,
    "token": token,
    "export": export,
    "events": events,
    "check-config": check_config,
    "registers": registers,
    "refraction": refraction,
    "devices": devices,
    "doctor": doctor,
    "diagnose": diagnose,
    "backup": backup,
    "restore": restore,
    "ingest": ingest,
    "fleet": fleet,
}

_WITHOUT_CONFIG = ("diagnose", "doctor", "status", "watch")

_FIRST_STEPS = """first steps:
  altd doctor             list the faults of this computer, with remedies
  altd devices            list the connected cameras, GPIO lines and serial ports
  altd check-config FILE  check settings; each error with its line
  altd COMMAND --help     list the options of a command
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the arguments and run the command; return the exit status of the process."""
    name = "altd"

    def work() -> int:
        nonlocal name
        parser = command_parser()
        options = parser.parse_command(arguments)
        if options is None:
            return 2
        name = f"altd {options.command}"
        _choose_config(parser, options)
        _set_up_libraries()
        return COMMANDS[options.command].run(options)

    return run_to_end(work, lambda: name)


def _set_up_libraries() -> None:
    # Before numpy is imported: our matrices are small, and threads of the linear algebra would mostly wait
    # for each other, at the cost of a core: next to a busy process a calibration took 22 s instead of 5 s.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 28))  # 16384 × 16384; before cv2 is imported
    import cv2

    cv2.utils.logging.setLogLevel(
        cv2.utils.logging.LOG_LEVEL_SILENT
    )  # an unreadable image is reported by our own error line, not OpenCV's
    cv2.setNumThreads(1)  # a frame is small: more threads cost more than they gain


def _choose_config(parser: Parser, options: argparse.Namespace) -> None:
    """Select the config of the service if it exists and no other is named; some commands need none."""
    if "config" not in options or options.config is not None:
        return
    if DEFAULT_CONFIG.is_file():
        options.config = DEFAULT_CONFIG
    elif options.command not in _WITHOUT_CONFIG:
        parser.refuse(options.command, f"missing: --config FILE, because there is no {DEFAULT_CONFIG}")


def command_parser() -> Parser:
    """Return the parser of all commands."""
    parser = Parser(
        prog="altd", description="The measuring daemon of an Active Laser Target.", epilog=_FIRST_STEPS
    )
    parser.add_argument("--version", action="version", version=f"altd {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    for name, command in COMMANDS.items():
        command.add_arguments(commands.add_parser(name, help=command.SUMMARY, description=command.SUMMARY))
    return parser
