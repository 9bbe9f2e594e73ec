"""The certificate: read at the start, and read again when it was renewed."""

from __future__ import annotations

import ssl
from collections.abc import Callable
from pathlib import Path

from altd.credentials.certificates import server_context
from altd.errors import BadInputError

HANDSHAKE_TIMEOUT_S = 5.0
"""A client that has not done its part of the handshake by then is cut off."""

SHUTDOWN_TIMEOUT_S = 1.0
MAX_HANDSHAKES = 16
"""Handshakes at a time; what comes while there are so many is closed."""

_Stamp = tuple[int, ...]


class Certificate:
    """Certificate and key in their files.

    ``complain`` is told of new ones that cannot be used, and with an empty text of those that can. Raises
    BadInputError when they cannot be used at the start.
    """

    def __init__(self, certificate: Path, key: Path, complain: Callable[[str], object]) -> None:
        self._certificate = certificate
        self._key = key
        self._complain = complain
        self._stamp = self._stamp_now()
        self._context = server_context(certificate, key)

    def context(self) -> ssl.SSLContext:
        """What handshakes are made with now: new files as soon as they fit, until then the old ones."""
        stamp = self._stamp_now()
        if stamp != self._stamp:
            self._stamp = stamp
            try:
                self._context = server_context(self._certificate, self._key)
                self._complain("")
            except BadInputError as error:
                self._complain(str(error))
        return self._context

    def _stamp_now(self) -> _Stamp:
        stamp: list[int] = []
        for path in (self._certificate, self._key):
            try:
                found = path.stat()
                stamp += [found.st_mtime_ns, found.st_ino, found.st_size]
            except (OSError, ValueError):
                stamp.append(0)
        return tuple(stamp)
