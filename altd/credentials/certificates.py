"""TLS contexts from files with certificates and keys: of the unit as a server and as a client."""

from __future__ import annotations

import ssl
import stat
from collections.abc import Callable, Sequence
from pathlib import Path

from altd.errors import BadInputError
from altd.files.reading import check_rights


def server_context(
    certificate: Path, key: Path, client_ca: Path | None = None, protocols: Sequence[str] = ()
) -> ssl.SSLContext:
    """Return a context for TLS 1.2 and later with this certificate; raises BadInputError that names the file.

    :param client_ca: the authorities that vouch for clients; None: clients present no certificate.
    :param protocols: protocols over TLS, for clients that negotiate them (ALPN).
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION
    _load(context, certificate, key)
    if protocols:
        context.set_alpn_protocols(list(protocols))
    if client_ca is not None:
        context.verify_mode = ssl.CERT_REQUIRED
        _load_authorities(context, client_ca)
    return context


def client_context(ca: Path, certificate: Path | None, key: Path | None) -> ssl.SSLContext:
    """Return a context for TLS 1.2 and later with servers that ``ca`` vouches for; their names are checked.

    ``certificate`` and ``key`` are the unit's own. Raises BadInputError that names the file.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    _load_authorities(context, ca)
    if certificate is not None and key is not None:
        _load(context, certificate, key)
    return context


def _load(context: ssl.SSLContext, certificate: Path, key: Path) -> None:
    check_rights(certificate)
    check_rights(key, 0)
    if _holds_key(certificate) and not _holds_key(key):
        raise BadInputError(key, f"contains no private key, but {certificate} does: the two are swapped")
    check_rights(key, stat.S_IRWXO)
    _load_authorities(ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT), certificate)
    try:
        context.load_cert_chain(certificate, key, password=_no_passphrase)
    except ssl.SSLError as error:
        raise BadInputError(key, _why(error)) from error
    except _PassphraseError as error:
        raise BadInputError(
            key, "asks for a passphrase, which a daemon cannot type: take a key without one"
        ) from error


def _load_authorities(context: ssl.SSLContext, certificates: Path) -> None:
    check_rights(certificates)
    try:
        context.load_verify_locations(certificates)
    except ssl.SSLError as error:
        raise BadInputError(certificates, "contains no certificate (PEM)") from error


class _PassphraseError(Exception):
    pass


def _no_passphrase() -> str:
    raise _PassphraseError


def _why(error: ssl.SSLError) -> str:
    if error.reason == "KEY_VALUES_MISMATCH":
        return "is not the key of the certificate"
    reason = (error.reason or "").replace("_", " ").lower()
    if error.reason in (None, "PEM_LIB", "NO_START_LINE", "PEM") or "pem" in reason:
        return "contains no usable private key (PEM)"
    return f"cannot be used with the certificate: {reason}"


def _holds_key(path: Path) -> bool:
    return b"PRIVATE KEY-----" in path.read_bytes()


class RenewedContext:
    """A context for TLS that is recreated when one of its files was renewed.

    :param make: creates it; raises BadInputError, which is passed on at the start.
    :param files: the files that it is made from.
    :param report_error: receives the reason if renewed files cannot be used, and an empty text once they can.
    """

    def __init__(
        self, make: Callable[[], ssl.SSLContext], files: Sequence[Path], report_error: Callable[[str], object]
    ) -> None:
        self._make, self._files, self._report_error = make, files, report_error
        self._stamp = self._stamp_now()
        self._context = make()

    def __call__(self) -> ssl.SSLContext:
        """Return the context for new handshakes: new files once they are usable, until then the old ones."""
        stamp = self._stamp_now()
        if stamp != self._stamp:
            self._stamp = stamp
            try:
                self._context = self._make()
                self._report_error("")
            except BadInputError as error:
                self._report_error(str(error))
        return self._context

    def _stamp_now(self) -> tuple[int, ...]:
        stamp: list[int] = []
        for path in self._files:
            try:
                found = path.stat()
                stamp += [found.st_mtime_ns, found.st_ino, found.st_size]
            except (OSError, ValueError):
                stamp.append(0)
        return tuple(stamp)


_ROLE_OID = bytes.fromhex("2b0601040183890c862201")
"""OID 1.3.6.1.4.1.50316.802.1 (MODBUS/TCP Security v36, R-21)."""

_UTF8_STRING, _EXTENSIONS = 0x0C, 0xA3


def role_of(certificate: bytes) -> str | None:
    """Return the Modbus role in a DER certificate whose signature TLS has verified; None: not exactly one.

    The role is a UTF8String in an extension (MODBUS/TCP Security v36, R-21, R-22, R-65). The structure is
    that of RFC 5280, 4.1: a search for the identifier's bytes would also find them in a subject's name.
    """
    try:
        ((_, signed),) = _elements(certificate)
        to_be_signed = _elements(_elements(signed)[0][1])
        roles = []
        for _, extensions in (element for element in to_be_signed if element[0] == _EXTENSIONS):
            for _, extension in _elements(_elements(extensions)[0][1]):
                (_, identifier), *_, (_, value) = _elements(extension)
                if identifier == _ROLE_OID:
                    roles += _elements(value)
        ((tag, text),) = roles
        return text.decode() if tag == _UTF8_STRING else None
    except (ValueError, IndexError):
        return None


def _elements(der: bytes) -> list[tuple[int, bytes]]:
    """Tag and content of consecutive elements; raises ValueError or IndexError."""
    elements = []
    while der:
        begin, length = 2, der[1]
        if length & 0x80:
            begin += length & 0x7F
            length = int.from_bytes(der[2:begin], "big")
        if begin + length > len(der):
            raise ValueError("cut off")
        elements.append((der[0], der[begin : begin + length]))
        der = der[begin + length :]
    return elements
