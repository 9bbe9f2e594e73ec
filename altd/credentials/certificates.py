"""Certificates and keys in their files, as TLS takes them: of the unit as a server and as a client."""

from __future__ import annotations

import ssl
import stat
from pathlib import Path

from altd.errors import BadInputError


def server_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """TLS 1.2 and later with this certificate; raises BadInputError that names the file."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION
    context.set_alpn_protocols(["http/1.1"])
    _load(context, certificate, key)
    return context


def client_context(ca: Path, certificate: Path | None, key: Path | None) -> ssl.SSLContext:
    """TLS 1.2 and later with servers that ``ca`` vouches for; their names are compared.

    ``certificate`` and ``key`` are the unit's own. Raises BadInputError that names the file.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    _load_authorities(context, ca)
    if certificate is not None and key is not None:
        _load(context, certificate, key)
    return context


def _load(context: ssl.SSLContext, certificate: Path, key: Path) -> None:
    _check_readable(certificate)
    if _check_readable(key) & stat.S_IRWXO:
        raise BadInputError(key, f"everybody may read it, and it is a key: chmod 640 {key}")
    _load_authorities(ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT), certificate)
    try:
        context.load_cert_chain(certificate, key, password=_no_passphrase)
    except ssl.SSLError as error:
        raise BadInputError(key, _why(error)) from error
    except _PassphraseError as error:
        raise BadInputError(key, "asks for a passphrase, and nobody is there to type one") from error


def _load_authorities(context: ssl.SSLContext, certificates: Path) -> None:
    _check_readable(certificates)
    try:
        context.load_verify_locations(certificates)
    except ssl.SSLError as error:
        raise BadInputError(certificates, "holds no certificate (PEM)") from error


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
