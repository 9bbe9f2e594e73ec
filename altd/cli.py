"""The command line: ``altd COMMAND``. Exit status 0 good, 2 bad arguments or bad file, 1 anything else."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from altd import __version__
from altd.arguments import Parser
from altd.endings import run_to_end

DEFAULT_CONFIG = Path("/etc/altd/altd.toml")
"""Where the service has its settings (docs/install.md)."""

_FIRST_STEPS = """first steps:
  altd doctor             what this computer lacks, and what mends it
  altd devices            which cameras, GPIO lines and serial ports are connected
  altd check-config FILE  whether settings can be used, and where not
  altd COMMAND --help     what a command takes
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse and run; the return value is the process' exit status."""
    name = "altd"

    def work() -> int:
        nonlocal name
        parser = _parser()
        options = parser.parse_command(arguments)
        if options is None:
            return 2
        name = f"altd {options.command}"
        _choose_config(parser, options)
        # Before numpy is there: our matrices are small, and threads of the linear algebra would mostly wait
        # for each other, at the cost of a core: beside a busy process a calibration took 22 s, and takes 5 s.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        # 16384 × 16384; before cv2 is there
        os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 28))
        from altd import commands

        return commands.run(options)

    return run_to_end(work, lambda: name)


def _choose_config(parser: Parser, options: argparse.Namespace) -> None:
    """Where no config is named, the one of the service, if there is one; only the doctor does without."""
    if "config" not in options or options.config is not None:
        return
    if DEFAULT_CONFIG.is_file():
        options.config = DEFAULT_CONFIG
    elif options.command != "doctor":
        argument = "FILE" if options.command == "check-config" else "--config FILE"
        parser.refuse(options.command, f"missing: {argument}, for there is no {DEFAULT_CONFIG}")


def _parser() -> Parser:
    parser = Parser(
        prog="altd",
        description="The measuring daemon of an Active Laser Target.",
        epilog=_FIRST_STEPS,
    )
    parser.add_argument("--version", action="version", version=f"altd {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")

    run = commands.add_parser("run", help="the daemon")
    _add_config(run)

    calibrate = commands.add_parser(
        "calibrate", help="fit the maps from a scan or an LED plate; prints the residuals"
    )
    calibrate.add_argument("recording", type=Path, metavar="RECORDING")
    calibrate.add_argument("-o", "--output", type=Path, required=True, metavar="FILE")
    calibrate.add_argument("--flat", type=Path, metavar="DIR", help="a recording of the evenly lit targets")
    calibrate.add_argument("--report", type=Path, metavar="DIR", help="what it rests on, as HTML and PDF")

    replay = commands.add_parser("replay", help="measure a recording: a JSON object a line, a table, a plot")
    replay.add_argument("recording", type=Path, metavar="RECORDING")
    replay.add_argument("--calibration", type=Path, required=True, metavar="FILE")
    replay.add_argument(
        "--window", type=_count, metavar="N", help="exposures averaged (20; of a scan all of a node)"
    )
    replay.add_argument("--every", type=_count, metavar="N", help="a line after so many (1)")
    replay.add_argument("--format", choices=("jsonl", "csv", "parquet"), default="jsonl", help="(jsonl)")
    replay.add_argument("-o", "--output", type=Path, metavar="FILE", help="into a file instead of on stdout")
    replay.add_argument("--plot", type=Path, metavar="FILE", help="values over time and reasons, as SVG")

    record = commands.add_parser("record", help="keep frames for replay")
    _add_config(record)
    record.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    record.add_argument("--seconds", type=_seconds, required=True, metavar="S")
    record.add_argument(
        "--kind",
        choices=("measurement", "flat", "self-check"),
        default="measurement",
        help="what it shows (measurement)",
    )

    scan = commands.add_parser(
        "scan", help="make a calibration scan with the stage; goes on where it stopped"
    )
    _add_config(scan)
    scan.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")

    lamps = commands.add_parser("lamps", help="switch frame LEDs and indicators while the daemon is stopped")
    lamps.add_argument(
        "look",
        choices=("off", "on", "test", "stopped"),
        help="off: dark; on: all lit until Ctrl-C; test: each in turn, by name; "
        "stopped: dark but for Error if the service has failed (for systemd, reads $SERVICE_RESULT)",
    )
    _add_config(lamps)

    locate = commands.add_parser(
        "locate", help="find the spot in images by two localisers; one JSON object an image"
    )
    locate.add_argument("images", type=Path, nargs="+", metavar="IMAGE")
    locate.add_argument("--format", choices=("jsonl", "csv"), default="jsonl", help="(jsonl)")

    mapping = commands.add_parser("map", help="px to mm: reads 'u v' lines")
    mapping.add_argument("--calibration", type=Path, required=True, metavar="FILE")
    mapping.add_argument("--target", required=True, metavar="NAME")
    mapping.add_argument(
        "--format", choices=("jsonl", "csv"), help="without: 'x_mm y_mm sigma_x_mm sigma_y_mm'"
    )

    check = commands.add_parser("check-config", help="say whether a config can be used")
    check.add_argument("config", type=Path, nargs="?", metavar="FILE", help=f"({DEFAULT_CONFIG})")

    commands.add_parser("devices", help="list cameras, GPIO lines and serial ports as the config wants them")

    doctor = commands.add_parser("doctor", help="say what is wrong on this computer, and what mends it")
    _add_config(doctor)
    return parser


def _add_config(command: argparse.ArgumentParser) -> None:
    command.add_argument("--config", type=Path, metavar="FILE", help=f"the settings ({DEFAULT_CONFIG})")


def _count(text: str) -> int:
    value = int(text) if text.isdecimal() and len(text) < 9 else 0
    if not 1 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number from 1 to 1000")
    return value


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value <= 86_400:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds up to one day")
    return value


if __name__ == "__main__":
    sys.exit(main())
