"""The credentials file, read and changed: one line per entry, hashes only, for its owner and group at most.

password NAME scrypt N R P SALT HASH     salt and hash in hexadecimal
token NAME sha256 HASH
"""

from __future__ import annotations

import hmac
import os
import re
import stat
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from altd.credentials.hashes import DUMMY_HASH, PasswordHash, token_digest
from altd.errors import BadInputError
from altd.files.reading import check_rights, read_file
from altd.files.writing import write_file

Value = TypeVar("Value")

MAX_ENTRIES = 64
MAX_BYTES = 1 << 15

_HEAD = "# altd-credentials/1: made by `altd password` and `altd token`; hashes alone\n"
_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")
_TOO_OPEN = stat.S_IWGRP | stat.S_IRWXO
"""Forbidden permissions: the group may read, for a daemon of another user; others have no access."""


@dataclass(frozen=True, slots=True)
class Credentials:
    """Users that may act: hashes by name. A name may have a password, a token or both."""

    passwords: Mapping[str, PasswordHash] = field(default_factory=dict)
    tokens: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def names(self) -> frozenset[str]:
        """Names of all users that may act."""
        return frozenset(self.passwords) | frozenset(self.tokens)

    def is_password(self, name: str, password: str) -> bool:
        """Whether it is the password of this name; an unknown name takes as long. Takes 0.2 s."""
        known = self.passwords.get(name)
        fits = (known or DUMMY_HASH).fits(password)
        return fits and known is not None

    def password_of(self, name: str) -> PasswordHash | None:
        """Hash of the user's password, unique to it: setting the same password again changes the hash."""
        return self.passwords.get(name)

    def name_of_token(self, token: str) -> str | None:
        """User of a token; None: no user. All tokens are compared, each in constant time."""
        digest, found = token_digest(token), None
        for name, known in self.tokens.items():
            if hmac.compare_digest(known, digest):
                found = name
        return found

    def with_password(self, name: str, password: PasswordHash | None) -> Credentials:
        """Return a copy with this password of this name; None: without."""
        return replace(self, passwords=_with(self.passwords, name, password))

    def with_token(self, name: str, digest: bytes | None) -> Credentials:
        """Return a copy with this token of this name; None: without."""
        return replace(self, tokens=_with(self.tokens, name, digest))


def _with(known: Mapping[str, Value], name: str, value: Value | None) -> dict[str, Value]:
    others = {each: kept for each, kept in known.items() if each != name}
    return others if value is None else {**others, name: value}


def is_name(name: str) -> bool:
    """Whether it can be a user name: lower-case letters, digits and _, a letter first, at most 32."""
    return _NAME.fullmatch(name) is not None


def load_credentials(path: Path) -> Credentials:
    """Read the file; raises BadInputError that names the file and the line."""
    try:
        content = read_file(path, MAX_BYTES)
    except BadInputError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            raise BadInputError(path, f"{error.message}; `altd password {path} NAME` makes it") from error
        raise
    check_rights(path, _TOO_OPEN)
    try:
        lines = content.decode("ascii").splitlines()
    except UnicodeDecodeError as error:
        raise BadInputError(path, "contains characters other than ASCII") from error
    credentials, entries = Credentials(), 0
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        entries += 1
        if entries > MAX_ENTRIES:
            raise BadInputError(path, f"has more than {MAX_ENTRIES} entries")
        try:
            credentials = _with_entry(credentials, words)
        except ValueError as error:
            raise BadInputError(f"{path}: line {number}", str(error)) from error
    return credentials


def load_login(path: Path) -> tuple[str, str]:
    """Return user name and password for a broker, one line each; raises BadInputError that names the file."""
    content = read_file(path, MAX_BYTES)
    check_rights(path, _TOO_OPEN)
    try:
        lines = content.decode().splitlines()
    except UnicodeDecodeError as error:
        raise BadInputError(path, "is not UTF-8") from error
    if len(lines) != 2 or not all(lines):
        raise BadInputError(path, "must have two lines: the user name and the password")
    return lines[0], lines[1]


def save_credentials(path: Path, credentials: Credentials) -> None:
    """Write the whole file; the umask determines the permissions of a new one. Raises BadInputError."""
    if len(credentials.passwords) + len(credentials.tokens) > MAX_ENTRIES:
        raise BadInputError(path, f"has {MAX_ENTRIES} entries already")
    write_file(path, (_HEAD + "".join(f"{line}\n" for line in _lines(credentials))).encode())


def _lines(credentials: Credentials) -> Iterator[str]:
    for name, known in credentials.passwords.items():
        parameters = f"{known.n} {known.r} {known.p} {known.salt.hex()} {known.digest.hex()}"
        yield f"password {name} scrypt {parameters}"
    for name, digest in credentials.tokens.items():
        yield f"token {name} sha256 {digest.hex()}"


def _with_entry(credentials: Credentials, words: list[str]) -> Credentials:
    """Add the entry of a line; raises ValueError that names the fault and never shows the line."""
    match words:
        case ["password", name, "scrypt", n, r, p, salt, digest]:
            if name in credentials.passwords:
                raise ValueError(f"{name!r} has a password already")
            known = PasswordHash(_whole(n), _whole(r), _whole(p), _bytes(salt), _bytes(digest))
            return credentials.with_password(_name(name), known)
        case ["token", name, "sha256", digest]:
            if name in credentials.tokens:
                raise ValueError(f"{name!r} has a token already")
            if len(_bytes(digest)) != 32:
                raise ValueError("its hash has a wrong length")
            return credentials.with_token(_name(name), _bytes(digest))
    raise ValueError("is not an entry; `altd password` and `altd token` make them")


def _name(word: str) -> str:
    if not is_name(word):
        raise ValueError(f"{word[:40]!r} is not a valid name; possible: a to z, 0 to 9 and _, a letter first")
    return word


def _whole(word: str) -> int:
    if not re.fullmatch(r"[0-9]{1,9}", word):
        raise ValueError("its scrypt parameters are not possible")
    return int(word)


def _bytes(word: str) -> bytes:
    if not re.fullmatch(r"(?:[0-9a-f]{2}){1,64}", word):
        raise ValueError("its salt or hash is not hexadecimal")
    return bytes.fromhex(word)


_OWNER_ALONE = 0o077


def check_name(name: str) -> None:
    """Raise BadInputError for a name that is not allowed."""
    if not is_name(name):
        text = f"{name[:40]!r} is not a valid name; possible: a to z, 0 to 9 and _, a letter first, up to 32"
        raise BadInputError("NAME", text)


def change(path: Path, name: str, changed: Callable[[Credentials], Credentials]) -> None:
    """Change the entries of a name; a new file is accessible only to its owner.

    Raises BadInputError, also if a password or token to remove does not exist; the file then stays as
    it was.
    """
    check_name(name)
    before = load_credentials(path) if os.path.lexists(path) else Credentials()
    after = changed(before)
    if after == before:
        raise BadInputError(path, f"{name} has none to remove")
    umask = os.umask(_OWNER_ALONE)
    try:
        save_credentials(path, after)
    finally:
        os.umask(umask)


_Stamp = tuple[int, int, int, int] | None


class CredentialsKeeper:
    """Reads the file again when it was replaced or changed.

    ``report_error`` receives the reason if the file cannot be used, and an empty text once it can. Without a
    usable file no user may act. Raises BadInputError when the file cannot be used at the start.
    """

    def __init__(self, path: Path, report_error: Callable[[str], object] = lambda _: None) -> None:
        self._path = path
        self._report_error = report_error
        self._stamp = self._stamp_now()
        self._known = load_credentials(path)

    def current(self) -> Credentials:
        """Return the users that may act now."""
        stamp = self._stamp_now()
        if stamp != self._stamp:
            self._stamp = stamp
            try:
                self._known = load_credentials(self._path)
                self._report_error("")
            except BadInputError as error:
                self._known = Credentials()
                self._report_error(str(error))
        return self._known

    def _stamp_now(self) -> _Stamp:
        try:
            found = self._path.stat()
        except (OSError, ValueError):
            return None
        return found.st_mtime_ns, found.st_ino, found.st_size, found.st_mode
