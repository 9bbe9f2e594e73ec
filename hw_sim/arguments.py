"""Common parts of the simulator's commands: arguments and progress."""

import argparse
import sys
from pathlib import Path

from hw_sim.hardness import HARD
from hw_sim.recording import Progress


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folder of the recording and its unit."""
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="DIR",
        help="new or empty folder for the recording",
    )
    parser.add_argument("--seed", type=natural, default=1, help="selects the unit (default: 1)")
    parser.add_argument(
        "--hard",
        action="store_const",
        const=HARD,
        help="add laser speckle, flaws of print and beam, filter, glare and blur, as docs/simulator.md lists",
    )


def add_demo_arguments(parser: argparse.ArgumentParser, seed: str) -> None:
    """Add the seed (``seed`` is the text of what it selects), the duration and the port of the page."""
    parser.add_argument("--seed", type=natural, default=1, help=seed)
    parser.add_argument("--seconds", type=seconds, metavar="N", help="end after N seconds (default: never)")
    parser.add_argument(
        "--http-port", type=port, default=0, metavar="PORT", help="port of HTTP (default: a free one)"
    )


def natural(text: str) -> int:
    """Parse an integer of at least 0."""
    return _whole(text, 0)


def at_least_one(text: str) -> int:
    """Parse an integer of at least 1."""
    return _whole(text, 1)


def _whole(text: str, minimum: int) -> int:
    value = int(text) if text.isdecimal() and len(text) <= 18 else -1
    if value < minimum:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number from {minimum} on")
    return value


def port(text: str) -> int:
    """Parse a TCP port; 0 selects any free port."""
    number = int(text) if text.isdecimal() and len(text) < 9 else -1
    if not 0 <= number <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no TCP port")
    return number


def seconds(text: str) -> float:
    """Parse a duration above 0, s."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value <= 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds above 0")
    return value


def terminal_progress(what: str) -> Progress:
    """Return a counter on standard error if that is a terminal, else a function that does nothing."""
    if not sys.stderr.isatty():
        return lambda _done, _planned: None

    def show(done: int, planned: int) -> None:
        end = "\n" if done == planned else ""
        print(f"\r{what}: {done}/{planned} exposures", end=end, file=sys.stderr, flush=True)

    return show
