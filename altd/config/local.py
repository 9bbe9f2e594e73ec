"""The local socket: where the unit's own computer speaks with the daemon."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator

from altd.config.complaints import complaint, shown
from altd.config.table import Table

MAX_SOCKET_BYTES = 107
"""Of a socket's path: 108 with the byte that ends it (unix(7))."""


def _socket(path: Path) -> Path:
    if not path.is_absolute() or not str(path).isprintable():
        raise complaint(
            ((), f"{shown(str(path))} is no path from the root; possible: one such as /run/altd/altd.sock")
        )
    if (size := len(str(path).encode())) > MAX_SOCKET_BYTES:
        raise complaint(((), f"{size} bytes are too long for a socket; possible: up to {MAX_SOCKET_BYTES}"))
    return path


class LocalSettings(Table):
    """The socket of `altd status`, `altd watch` and `altd selfcheck`, a file that says who may ask."""

    socket: Annotated[Path, AfterValidator(_socket)] = Path("/run/altd/altd.sock")
    """Its path; the folder must be there."""
