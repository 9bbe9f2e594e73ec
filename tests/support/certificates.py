"""Certificates and keys that openssl makes."""

import subprocess
from pathlib import Path

from support.foreign import need_program

Files = tuple[Path, Path]
"""A certificate and its key."""

ROLE = "1.3.6.1.4.1.50316.802.1=ASN1:UTF8String:"
"""The extension of MODBUS/TCP Security, before the role."""

AUTHORITY = ("-addext", "keyUsage=critical,keyCertSign,cRLSign")
"""For a certificate that signs others: Python 3.13 and later ask for it (RFC 5280, 4.2.1.3)."""

_KEY = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-noenc")


def made(folder: Path, name: str, *more: str, ca: Files | None = None) -> Files:
    """A certificate, self-signed as docs/http.md makes it, or signed by ``ca``."""
    certificate, key = folder / f"{name}.pem", folder / f"{name}.key"
    line = ["req", "-x509", *_KEY, "-days", "30", "-subj", f"/CN={name}", *more]
    if ca is not None:
        line += ["-CA", str(ca[0]), "-CAkey", str(ca[1]), "-addext", "basicConstraints=critical,CA:false"]
    _openssl(*line, "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(certificate))
    key.chmod(0o600)
    return certificate, key


def expired(folder: Path, ca: Files) -> Files:
    """One that was good until yesterday."""
    request, certificate, key = (folder / f"expired.{end}" for end in ("csr", "pem", "key"))
    _openssl("req", "-new", *_KEY, "-subj", "/CN=expired", "-keyout", str(key), "-out", str(request))
    line = ["x509", "-req", "-in", str(request), "-days", "-1", "-CA", str(ca[0]), "-CAkey", str(ca[1])]
    _openssl(*line, "-CAcreateserial", "-out", str(certificate))
    return certificate, key


def _openssl(*words: str) -> None:
    subprocess.run([need_program("openssl"), *words], check=True, capture_output=True)
