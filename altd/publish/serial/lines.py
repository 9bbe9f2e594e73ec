"""From the keys of a terminal to lines: echo, backspace, and patience with what is not text."""

from __future__ import annotations

from enum import Enum

LONGEST_LINE = 70

_BACKSPACES = b"\x08\x7f"
_CLEARS = b"\x03\x15"  # Ctrl-C, Ctrl-U
_LINE_ENDS = b"\r\n"
_ESC = 0x1B


class BadLine(Enum):
    """A line that is not worth reading, with what to tell the person."""

    TOO_LONG = f"line too long: at most {LONGEST_LINE} characters"
    NO_TEXT = "that was no text: wrong baud rate or parity?"


class LineEditor:
    """Takes one byte at a time and keeps at most one line. A CR, an LF or a CR LF pair ends a line."""

    def __init__(self) -> None:
        self._line = bytearray()
        self._bad: BadLine | None = None
        self._escape = bytearray()
        self._after_cr = False

    def take(self, byte: int) -> bytes | str | BadLine:
        """What to echo, or the line that this byte ended."""
        after_cr, self._after_cr = self._after_cr, byte == ord("\r")
        if byte in _LINE_ENDS:
            return b"" if after_cr and byte == ord("\n") else self._end()
        if self._in_escape(byte):
            return b""
        if byte in _CLEARS:
            self._bad = None
            return self._erase(len(self._line))
        if byte in _BACKSPACES:
            return self._erase(1)
        if not 0x20 <= byte < 0x7F:
            self._bad = BadLine.NO_TEXT
        elif len(self._line) == LONGEST_LINE:
            self._bad = self._bad or BadLine.TOO_LONG
        elif self._bad is None:
            self._line.append(byte)
            return bytes([byte])
        return b""

    def discard(self, byte: int) -> bool:
        """Take a byte that is no part of a line; whether it was a key (the LF of a CR LF pair is none)."""
        second_half = self._after_cr and byte == ord("\n")
        self.take(byte)
        self._line.clear()
        self._bad = None
        return not second_half

    def _end(self) -> str | BadLine:
        line, bad = self._line.decode("ascii"), self._bad
        self._line.clear()
        self._escape.clear()
        self._bad = None
        return bad or line

    def _erase(self, count: int) -> bytes:
        count = min(count, len(self._line))
        del self._line[len(self._line) - count :]
        return b"\b \b" * count

    def _in_escape(self, byte: int) -> bool:
        """Swallow the sequence that an arrow or function key sends: ESC, ``[`` or ``O``, up to a letter."""
        if byte == _ESC:
            self._escape[:] = b"\x1b"
            return True
        if not self._escape:
            return False
        opened = len(self._escape) > 1
        if (opened and 0x20 <= byte < 0x40 and len(self._escape) < 16) or (not opened and byte in b"[O"):
            self._escape.append(byte)
            return True
        self._escape.clear()
        return opened and 0x40 <= byte < 0x7F
