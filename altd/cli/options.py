"""Arguments that several commands take, and how far one has come."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

DEFAULT_CONFIG = Path("/etc/altd/altd.toml")
"""The settings file of the service (docs/install.md)."""


def add_credentials(parser: argparse.ArgumentParser) -> None:
    """The arguments of a command that changes a file of credentials."""
    parser.add_argument("file", type=Path, metavar="FILE", help="the file that `[http] credentials` names")
    parser.add_argument("name", metavar="NAME", help="user: lower-case letters, digits and _, a letter first")
    parser.add_argument("--remove", action="store_true", help="remove it")


def add_config(parser: argparse._ActionsContainer) -> None:
    """The settings; without, those of the service."""
    parser.add_argument("--config", type=Path, metavar="FILE", help=f"settings (default: {DEFAULT_CONFIG})")


def add_socket(parser: argparse.ArgumentParser) -> None:
    """The option for the socket of the running daemon."""
    add_config(parser)
    parser.add_argument(
        "--socket",
        type=Path,
        metavar="PATH",
        help="local socket of the daemon (default: that of its settings)",
    )


def socket_of(options: argparse.Namespace) -> Path:
    """The socket to ask; that of the service where neither it nor settings are named and it has none."""
    from altd.app.settings import SERVICE_SOCKET, load_settings, socket_to_ask

    if options.socket is not None:
        path: Path = options.socket
        return path
    return SERVICE_SOCKET if options.config is None else socket_to_ask(load_settings(options.config))


def add_output(parser: argparse.ArgumentParser, metavar: str, what: str) -> None:
    """The option for the file of the result."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=metavar, help=what)


def progress_on(what: str) -> Callable[[int, int], None]:
    """A counter on a terminal's stderr; nothing in a pipe."""
    if not sys.stderr.isatty():
        return lambda done, total: None

    def show(done: int, total: int) -> None:
        if done == total:
            sys.stderr.write("\r\033[K")
        elif done % 8 == 0:
            sys.stderr.write(f"\r{done}/{total} {what}")
        sys.stderr.flush()

    return show
