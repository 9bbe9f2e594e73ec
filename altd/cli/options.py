"""Arguments that several commands take, and how far one has come."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

DEFAULT_CONFIG = Path("/etc/altd/altd.toml")
"""Where the service has its settings (docs/install.md)."""


def add_config(parser: argparse.ArgumentParser) -> None:
    """The settings; without, those of the service."""
    parser.add_argument("--config", type=Path, metavar="FILE", help=f"the settings ({DEFAULT_CONFIG})")


def add_output(parser: argparse.ArgumentParser, metavar: str) -> None:
    """Where the result goes."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=metavar)


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
