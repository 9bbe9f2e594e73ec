"""The certificate: read at the start, and read again when it was renewed."""

from __future__ import annotations

import ssl
import stat
from collections.abc import Callable
from pathlib import Path

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
        self._context = context_of(certificate, key)

    def context(self) -> ssl.SSLContext:
        """What handshakes are made with now: new files as soon as they fit, until then the old ones."""
        stamp = self._stamp_now()
        if stamp != self._stamp:
            self._stamp = stamp
            try:
                self._context = context_of(self._certificate, self._key)
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


def context_of(certificate: Path, key: Path) -> ssl.SSLContext:
    """TLS 1.2 and later with this certificate; raises BadInputError that names the file."""
    _check_readable(certificate)
    if _check_readable(key) & stat.S_IRWXO:
        raise BadInputError(key, f"everybody may read it, and it is a key: chmod 640 {key}")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION
    context.set_alpn_protocols(["http/1.1"])
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(certificate)
    except ssl.SSLError as error:
        raise BadInputError(certificate, "holds no certificate (PEM)") from error
    try:
        context.load_cert_chain(certificate, key, password=_no_passphrase)
    except ssl.SSLError as error:
        raise BadInputError(key, _why(error)) from error
    except _PassphraseError as error:
        raise BadInputError(key, "asks for a passphrase, and nobody is there to type one") from error
    return context


class _PassphraseError(Exception):
    pass


def _no_passphrase() -> str:
    raise _PassphraseError


def _why(error: ssl.SSLError) -> str:
    if error.reason == "KEY_VALUES_MISMATCH":
        return "is not the key of the certificate"
    reason = (error.reason or "").replace("_", " ").lower()
    if error.reason in (None, "PEM_LIB", "NO_START_LINE", "PEM") or "pem" in reason:
        return "holds no private key (PEM) that can be used"
    return f"cannot be used with the certificate: {reason}"


def _check_readable(path: Path) -> int:
    """The file's mode; raises BadInputError for what is no file that can be read."""
    try:
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            raise BadInputError(path, "is no file")
        with path.open("rb"):
            return mode
    except OSError as error:
        raise BadInputError(path, error.strerror or "cannot be read") from error
    except ValueError as error:
        raise BadInputError(path, "is no path") from error
