"""Progress on a terminal."""

from __future__ import annotations

import sys


def show(what: str) -> None:
    """One line on standard error while it is a terminal; silence otherwise."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{what}")
        sys.stderr.flush()
