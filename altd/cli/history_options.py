"""Arguments of the commands that read a history: which one, and from when to when."""

from __future__ import annotations

import argparse
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

from altd.cli.options import DEFAULT_CONFIG
from altd.errors import BadInputError

_AGO = re.compile(r"-?(\d{1,9})([smhd])")
_UNITS_S = {"s": 1, "m": 60, "h": 3600, "d": 86_400}
_FROM = "start: a time such as 2026-11-20T08:15 (UTC), or -2h, also s, m, d (default: the oldest)"
_EARLIEST = datetime(1970, 1, 1, tzinfo=UTC)


def time_us(text: str) -> int:
    """A time of the command line as µs since 1970; raises argparse.ArgumentTypeError.

    ``2026-11-20``, ``2026-11-20T08:15``, ``2026-11-20T08:15:30.5Z``, with an offset such as ``+01:00``, or
    ``-2h``: two hours ago, likewise s, m and d. Without an offset it is UTC.
    """
    try:
        time = _time(text)
        if time < _EARLIEST:
            raise ValueError
    except (ValueError, OverflowError) as error:
        raise argparse.ArgumentTypeError(
            f"{text[:40]!r} is no time; possible: 2026-11-20T08:15:30Z, or -2h for two hours ago"
        ) from error
    return round(time.timestamp() * 1e6)


def _time(text: str) -> datetime:
    if ago := _AGO.fullmatch(text):
        return datetime.now(UTC) - timedelta(seconds=int(ago[1]) * _UNITS_S[ago[2]])
    time = datetime.fromisoformat(text)
    return time if time.tzinfo is not None else time.replace(tzinfo=UTC)


def add_span(parser: argparse.ArgumentParser) -> None:
    """From when to when."""
    parser.add_argument("--from", dest="from_us", type=time_us, metavar="TIME", help=_FROM)
    parser.add_argument(
        "--to", dest="to_us", type=time_us, metavar="TIME", help="end, not included (default: now)"
    )


def span_of(options: argparse.Namespace) -> tuple[int, int]:
    """From when to before when, µs since 1970; raises BadInputError where that is no time at all."""
    from_us = 0 if options.from_us is None else options.from_us
    to_us = 2**62 if options.to_us is None else options.to_us
    if from_us >= to_us:
        raise BadInputError("--to", "is not after --from")
    return from_us, to_us


def add_history(parser: argparse.ArgumentParser) -> None:
    """Which history: that of a daemon, by its settings, or a file."""
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        default=argparse.SUPPRESS,  # a file needs none
        help=f"settings of the daemon whose history it is (default: {DEFAULT_CONFIG})",
    )
    parser.add_argument("--history", type=Path, metavar="FILE", help="history file, or a copy of it")


def history_of(options: argparse.Namespace) -> Path:
    """The file to read; raises BadInputError."""
    if options.history is not None:
        if "config" in options:
            raise BadInputError("--config", "says where the history is: it goes with no --history")
        history: Path = options.history
        return history
    if "config" not in options and not DEFAULT_CONFIG.is_file():
        raise BadInputError("--history", f"missing, or --config FILE, for there is no {DEFAULT_CONFIG}")
    from altd.app.keeping import history_to_read
    from altd.app.settings import load_settings

    return history_to_read(load_settings(options.config if "config" in options else DEFAULT_CONFIG))
