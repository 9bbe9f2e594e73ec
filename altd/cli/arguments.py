"""Command-line arguments that several commands take, and their errors in one line."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NoReturn

from altd.errors import BadInputError, did_you_mean
from altd.process.standard_streams import print_errors

DEFAULT_CONFIG = Path("/etc/altd/altd.toml")
"""The settings file of the service (docs/install.md)."""


def add_credentials(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a command that changes a file of credentials."""
    parser.add_argument("file", type=Path, metavar="FILE", help="the file that `[http] credentials` names")
    parser.add_argument("name", metavar="NAME", help="user: lower-case letters, digits and _, a letter first")
    parser.add_argument("--remove", action="store_true", help="remove it")


def add_config(parser: argparse._ActionsContainer) -> None:
    """Add the option for the settings; the default is those of the service."""
    parser.add_argument("--config", type=Path, metavar="FILE", help=f"settings (default: {DEFAULT_CONFIG})")


def add_socket(parser: argparse.ArgumentParser) -> None:
    """Add the options for the socket of the running daemon."""
    add_config(parser)
    parser.add_argument(
        "--socket",
        type=Path,
        metavar="PATH",
        help="local socket of the daemon (default: that of its settings)",
    )


def socket_of(options: argparse.Namespace) -> Path:
    """Return the socket of the daemon; that of the service if neither a socket nor settings are given."""
    from altd.app.settings import SERVICE_SOCKET, load_settings, socket_to_ask

    if options.socket is not None:
        path: Path = options.socket
        return path
    place: Path | None = options.config
    return SERVICE_SOCKET if place is None else socket_to_ask(load_settings(place), place)


def add_output(parser: argparse.ArgumentParser, metavar: str, what: str) -> None:
    """Add the option for the file of the result."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=metavar, help=what)


def progress_on(what: str) -> Callable[[int, int], None]:
    """Return a counter on a terminal's stderr that does nothing in a pipe."""
    if not sys.stderr.isatty():
        return lambda done, total: None

    def show(done: int, total: int) -> None:
        if done == total:
            sys.stderr.write("\r\033[K")
        elif done % 8 == 0:
            sys.stderr.write(f"\r{done}/{total} {what}")
        sys.stderr.flush()

    return show


_AGO = re.compile(r"-?(\d{1,9})([smhd])")
_UNITS_S = {"s": 1, "m": 60, "h": 3600, "d": 86_400}
_CLOCK = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2}))?")
_FROM = (
    "start: 02:10 (the last such time, local), 2026-11-20T08:15 (UTC), or -2h, also s, m, d "
    "(default: the oldest)"
)
_EARLIEST = datetime(1970, 1, 1, tzinfo=UTC)


def time_us(text: str) -> int:
    """Parse a time of the command line to µs since 1970; raises argparse.ArgumentTypeError.

    ``2026-11-20``, ``2026-11-20T08:15``, ``2026-11-20T08:15:30.5Z``, with an offset such as ``+01:00``, or
    ``-2h``: two hours ago, likewise s, m and d. A time without an offset is UTC, except ``02:10`` or
    ``02:10:30``: the last such time, today or yesterday, in the local time of this computer.
    """
    try:
        time = _time(text)
        if time < _EARLIEST:
            raise ValueError
    except (ValueError, OverflowError) as error:
        raise argparse.ArgumentTypeError(
            f"{text[:40]!r} is not a time; possible: 2026-11-20T08:15:30Z, 02:10, or -2h for two hours ago"
        ) from error
    return round(time.timestamp() * 1e6)


def _time(text: str) -> datetime:
    if ago := _AGO.fullmatch(text):
        return datetime.now(UTC) - timedelta(seconds=int(ago[1]) * _UNITS_S[ago[2]])
    if clock := _CLOCK.fullmatch(text):
        now = datetime.now()  # local, as a person reads it from a clock
        wall = now.replace(hour=int(clock[1]), minute=int(clock[2]), second=int(clock[3] or 0), microsecond=0)
        return (wall if wall <= now else wall - timedelta(days=1)).astimezone(UTC)
    time = datetime.fromisoformat(text)
    return time if time.tzinfo is not None else time.replace(tzinfo=UTC)


def add_span(parser: argparse.ArgumentParser) -> None:
    """Add the options for start and end."""
    parser.add_argument("--from", dest="from_us", type=time_us, metavar="TIME", help=_FROM)
    parser.add_argument(
        "--to", dest="to_us", type=time_us, metavar="TIME", help="end, not included (default: now)"
    )


def span_of(options: argparse.Namespace) -> tuple[int, int]:
    """Return start and end (excluded), µs since 1970; raises BadInputError if the span is empty."""
    from_us = 0 if options.from_us is None else options.from_us
    to_us = 2**62 if options.to_us is None else options.to_us
    if from_us >= to_us:
        raise BadInputError("--to", "is not after --from")
    return from_us, to_us


def add_history(parser: argparse.ArgumentParser) -> None:
    """Add the options for the history: that of a daemon, by its settings, or a file."""
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        default=argparse.SUPPRESS,  # a history file needs none
        help=f"settings of the daemon whose history it is (default: {DEFAULT_CONFIG})",
    )
    parser.add_argument("--history", type=Path, metavar="FILE", help="history file, or a copy of it")


def history_of(options: argparse.Namespace) -> Path:
    """Return the history file to read; raises BadInputError."""
    if options.history is not None:
        if "config" in options:
            raise BadInputError("--config", "names the history file: it cannot be combined with --history")
        history: Path = options.history
        return history
    if "config" not in options and not DEFAULT_CONFIG.is_file():
        raise BadInputError("--history", f"missing, or --config FILE, because there is no {DEFAULT_CONFIG}")
    from altd.app.keeping import history_to_read
    from altd.app.settings import load_settings

    place: Path = options.config if "config" in options else DEFAULT_CONFIG
    return history_to_read(load_settings(place), place)


_CHOICE = re.compile(r"argument (.+?): invalid choice: (.+?) \(choose from ", re.DOTALL)
_MISSING = re.compile(r"the following arguments are required: (.*)", re.DOTALL)
_NO_NUMBER = re.compile(r"argument (.+?): invalid (int|float) value: (.*)", re.DOTALL)
_NO_VALUE = re.compile(r"argument (.+?): expected (.*)", re.DOTALL)
_QUOTES = "'\""


class Parser(argparse.ArgumentParser):
    """Reports an error of the arguments in one line, with the argument and its possible values."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.formatter_class = argparse.RawDescriptionHelpFormatter
        self._given: list[str] = []
        self._negative_number_matcher = re.compile(r"-\d")  # argparse's own: -2h is a value, not an option

    def parse_command(self, arguments: Sequence[str] | None) -> argparse.Namespace | None:
        """Parse the arguments of a command, its name in ``command``; None: no command, and help was shown.

        The help goes to standard error: nothing was done, and a script with an empty command must not take it
        for an answer.
        """
        options: argparse.Namespace
        options, unknown = self.parse_known_args(arguments)
        if unknown:
            self._command(options.command).refuse_unknown(unknown)
        if options.command is None:
            print_errors(*self.format_help().splitlines())
            return None
        return options

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as argparse does, and store the arguments for ``error``."""
        self._given = [] if args is None else list(args)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """End with status 2 and one line."""
        print_errors(str(BadInputError(self.prog, self._worded(message))))
        raise SystemExit(2)

    def _worded(self, message: str) -> str:
        if found := _CHOICE.match(message):
            name, value = found[1], found[2]
            choices = [str(choice) for choice in self._choices(name)]
            what = (
                f"unknown {name.lower()} {value}" if name == "COMMAND" else f"{name}: {value} is not possible"
            )
            slips = self._unknown_options() if name == "COMMAND" else ""
            return (
                f"{what}{slips}; possible: {', '.join(choices)}{did_you_mean(value.strip(_QUOTES), choices)}"
            )
        if found := _MISSING.match(message):
            return f"missing: {found[1]}{self._unknown_options()}; {self._one_line_usage()}"
        if found := _NO_NUMBER.match(message):
            return f"{found[1]}: {found[3]} is not a {'whole number' if found[2] == 'int' else 'number'}"
        if found := _NO_VALUE.match(message):
            count = found[2].replace("argument", "value")
            return f"{found[1]}: {count} must follow; {self._one_line_usage()}"
        return message.removeprefix("argument ")

    def refuse(self, command: str, message: str) -> NoReturn:
        """End with status 2 and a line about a command's arguments."""
        self._command(command).error(message)

    def refuse_unknown(self, unknown: list[str]) -> NoReturn:
        """End with status 2 and a line about the first unknown argument."""
        first = unknown[0]
        if not first.startswith("-") or first == "-":
            self.error(f"{first!r} is unexpected; {self._one_line_usage()}")
        options = [action.option_strings[-1] for action in self._actions if action.option_strings]
        slip = did_you_mean(first.partition("=")[0], options)
        self.error(f"{first}: unknown argument; possible: {', '.join(options)}{slip}")

    def _unknown_options(self) -> str:
        """The unknown arguments, each with similar known ones."""
        known = [name for action in self._actions for name in action.option_strings]
        strange = (word.partition("=")[0] for word in self._given if word.startswith("--"))
        slips = [word for word in strange if not any(name.startswith(word) for name in known)]
        return "".join(f"; unknown argument {word}{did_you_mean(word, known)}" for word in slips)

    def _choices(self, name: str) -> Sequence[object]:
        for action in self._actions:
            if name in ("/".join(action.option_strings), action.metavar, action.dest) and action.choices:
                return list(action.choices)
        return ()

    def _command(self, name: str | None) -> Parser:
        for action in self._actions:
            parser = action.choices.get(name) if isinstance(action.choices, Mapping) else None
            if isinstance(parser, Parser):
                return parser
        return self

    def _one_line_usage(self) -> str:
        return " ".join(self.format_usage().split())
