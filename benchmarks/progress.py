"""Progress on a terminal."""

from __future__ import annotations

import sys


def show(what: str) -> None:
    """Show one line on standard error if that is a terminal."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{what}")
        sys.stderr.flush()
