"""A file that is read several times without being held in memory, and is the same file each time."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from altd.errors import BadInputError
from altd.files.reading import read_first, read_pieces

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

_DIGEST_BYTES = 16
_MAX_LINE_LENGTH = 1 << 22


class UnchangedFile:
    """A regular file as it was when it was first read, here: of it only its length and a digest a piece stay.

    What is appended later is not seen. A piece that is read again and is another one raises BadInputError
    before any of it is handed on; so only checked content is used.
    """

    def __init__(self, path: Path, largest_bytes: int) -> None:
        """Raises BadInputError; also when the file is changed meanwhile."""
        self.path = path
        self._bytes = 0
        self._digests: list[bytes] = []
        for piece in read_pieces(path, largest_bytes):
            self._bytes += len(piece)
            self._digests.append(_digest(piece))

    def pieces(self) -> Iterator[bytes]:
        """The content, piece by piece; raises BadInputError."""
        again = read_first(self.path, self._bytes)
        for digest in self._digests:
            piece = next(again, b"")
            if _digest(piece) != digest:
                raise BadInputError(self.path, "was changed after it was checked")
            yield piece

    def lines(self) -> Iterator[str]:
        """The content as lines of UTF-8 with their ends, a byte order mark left out.

        Raises BadInputError, UnicodeDecodeError where it is no UTF-8.
        """
        text = io.TextIOWrapper(io.BufferedReader(_Pieces(self.pieces())), newline="", encoding="utf-8-sig")
        for number, line in enumerate(iter(lambda: text.readline(_MAX_LINE_LENGTH + 1), ""), start=1):
            if len(line) > _MAX_LINE_LENGTH:
                raise BadInputError(
                    f"{self.path}: row {number}", f"is longer than {_MAX_LINE_LENGTH} characters"
                )
            yield line


class _Pieces(io.RawIOBase):
    """Pieces as a stream of bytes."""

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
