"""Reading any path safely: regular files only, up to a size limit, never waiting.

``UnchangedFile`` is read several times without being kept in memory, and is the same file each time.
"""

from __future__ import annotations

import hashlib
import io
import os
import pwd
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from altd.errors import BadInputError

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

_PIECE_BYTES = 1 << 20

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFLNK: "a symbolic link",
}


def read_file(path: Path, largest_bytes: int, folder: int | None = None) -> bytes:
    """Return the content of a regular file of at most ``largest_bytes``.

    With ``folder``, the descriptor of an open folder, ``path`` is a name in it, and links are refused. Raises
    BadInputError, also when the file changed while it was read: the content is then neither the old nor the
    new one.
    """
    return b"".join(read_pieces(path, largest_bytes, folder))


def read_pieces(path: Path, largest_bytes: int, folder: int | None = None) -> Iterator[bytes]:
    """Yield the content piece by piece; a change meanwhile raises only after the last piece."""
    with _opened(path, folder) as descriptor:
        before = os.fstat(descriptor)
        if before.st_size > largest_bytes:
            raise BadInputError(path, f"is {before.st_size} bytes long, more than {largest_bytes}")
        length = 0
        while piece := _read(descriptor, min(_PIECE_BYTES, largest_bytes + 1 - length)):
            length += len(piece)
            yield piece
        after = os.fstat(descriptor)
        if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
            raise BadInputError(path, "was changed while it was read")
        if length > largest_bytes:  # a file of /proc, which reports no size
            raise BadInputError(path, f"is more than {largest_bytes} bytes long")


def read_first(path: Path, length_bytes: int) -> Iterator[bytes]:
    """Yield the first bytes of a regular file, in pieces of the same sizes as ``read_pieces``."""
    with _opened(path) as descriptor:
        left = length_bytes
        while piece := _read(descriptor, min(_PIECE_BYTES, left)):
            left -= len(piece)
            yield piece


def read_head(path: Path, head_bytes: int) -> bytes:
    """Return the first bytes of a regular file of any size; raises BadInputError."""
    with _opened(path) as descriptor:
        return _read(descriptor, head_bytes)


def check_rights(path: Path, forbidden: int = stat.S_IWOTH) -> None:
    """Raise BadInputError if the file cannot be read, or its mode has a bit of ``forbidden``."""
    with _opened(path) as descriptor:
        mode = os.fstat(descriptor).st_mode
    if mode & forbidden:
        may, repair = ("read or write", "640") if forbidden & stat.S_IROTH else ("write", "o-w")
        text = f"others than its owner may {may} it (mode {stat.S_IMODE(mode):04o}): chmod {repair} {path}"
        raise BadInputError(path, text)


def kind_of(mode: int) -> str:
    """Return the type of a non-regular file in plain words, from its ``st_mode``."""
    return _KINDS.get(stat.S_IFMT(mode), "no regular file")


def os_reason(error: OSError, path: Path | None) -> str:
    """Return the system's message; for a missing permission also the path's owner and the remedy."""
    text = error.strerror or "cannot be read"
    return text if path is None or not isinstance(error, PermissionError) else f"{text}{refusing(path)}"


def refusing(path: Path) -> str:
    """Return the file or folder that refuses this user, with owner, group and mode, and the remedy."""
    for place in (path, *path.absolute().parents):  # a folder without search permission hides its files
        try:
            status = place.stat()
        except OSError:
            continue
        user, owner = _user_name(os.geteuid()), _user_name(status.st_uid)
        mode = f"{stat.S_IMODE(status.st_mode):04o}"
        what = f"the folder {place}" if stat.S_ISDIR(status.st_mode) else "the file"
        return f": this is user {user}, {what} belongs to {owner}, mode {mode}; use sudo, or chmod and chgrp"
    return ""


def _user_name(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:  # in a container, or a service's former user
        return str(number)


@contextmanager
def _opened(path: Path, folder: int | None = None) -> Iterator[int]:
    """Open a regular file. Anything else is not even opened, because a device may react to it."""
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
    try:
        _check_regular(path, os.stat(path, dir_fd=folder, follow_symlinks=folder is None).st_mode)
        descriptor = os.open(path, flags if folder is None else flags | os.O_NOFOLLOW, dir_fd=folder)
        try:
            _check_regular(path, os.fstat(descriptor).st_mode)  # it may be another file by now
            yield descriptor
        finally:
            os.close(descriptor)
    except OSError as error:
        raise BadInputError(path, os_reason(error, path if folder is None else None)) from error
    except ValueError as error:  # a NUL, or characters that the file system does not support
        raise BadInputError(path, "is not a path") from error


def _check_regular(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        raise BadInputError(path, f"is {kind_of(mode)}, not a file")


def _read(descriptor: int, at_most_bytes: int) -> bytes:
    parts: list[bytes] = []
    left = at_most_bytes
    while left > 0 and (part := os.read(descriptor, min(left, 1 << 20))):
        parts.append(part)
        left -= len(part)
    return b"".join(parts)


_DIGEST_BYTES = 16
_MAX_LINE_LENGTH = 1 << 22


class UnchangedFile:
    """A regular file as of its first read, in ``__init__``; only its length and a digest per piece are kept.

    Bytes appended later are not read. A piece that differs when it is read again raises BadInputError before
    any of it is returned, so only checked content is used.
    """

    def __init__(self, path: Path, largest_bytes: int) -> None:
        """Read the file once; raises BadInputError, also if the file changes meanwhile."""
        self.path = path
        self._bytes = 0
        self._digests: list[bytes] = []
        for piece in read_pieces(path, largest_bytes):
            self._bytes += len(piece)
            self._digests.append(_digest(piece))

    def pieces(self) -> Iterator[bytes]:
        """Yield the content, piece by piece; raises BadInputError."""
        again = read_first(self.path, self._bytes)
        for digest in self._digests:
            piece = next(again, b"")
            if _digest(piece) != digest:
                raise BadInputError(self.path, "was changed after it was checked")
            yield piece

    def lines(self) -> Iterator[str]:
        """Yield the content as lines of UTF-8 with their ends, without a byte order mark.

        Raises BadInputError, and UnicodeDecodeError if it is not UTF-8.
        """
        text = io.TextIOWrapper(io.BufferedReader(_Pieces(self.pieces())), newline="", encoding="utf-8-sig")
        for number, line in enumerate(iter(lambda: text.readline(_MAX_LINE_LENGTH + 1), ""), start=1):
            if len(line) > _MAX_LINE_LENGTH:
                raise BadInputError(
                    f"{self.path}: row {number}", f"is longer than {_MAX_LINE_LENGTH} characters"
                )
            yield line


class _Pieces(io.RawIOBase):
    """Pieces as a byte stream."""

    def __init__(self, pieces: Iterator[bytes]) -> None:
        self._pieces = pieces
        self._left = memoryview(b"")

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        if not self._left:
            self._left = memoryview(next(self._pieces, b""))
        room = memoryview(buffer)
        count = min(len(room), len(self._left))
        room[:count] = self._left[:count]
        self._left = self._left[count:]
        return count


def _digest(piece: bytes) -> bytes:
    return hashlib.blake2b(piece, digest_size=_DIGEST_BYTES).digest()
