"""Converts keys to lines: editing within the line, a few earlier lines, tolerance of noise."""

from __future__ import annotations

from collections import deque
from enum import Enum

from altd.publish.serial.keys import Key

MAX_LINE_CHARACTERS = 70
MAX_RECALLED_LINES = 16
"""Maximum number of lines that the up and down keys recall."""

_MIN_NOISE_KEYS = 3
_BACK = b"\b"


class BadLine(Enum):
    """A line that is not evaluated; its value is the message for the person."""

    TOO_LONG = f"line too long: at most {MAX_LINE_CHARACTERS} characters"
    STRAY = "not plain ASCII: retype it or check the parity"
    NO_TEXT = "not text: wrong baud rate or parity?"


class LineEditor:
    """Takes one key at a time and keeps at most one line and ``MAX_RECALLED_LINES`` earlier ones.

    Its output consists of printable ASCII, blanks and backspaces, which every terminal supports. A character
    that is not ASCII is shown as ``?`` and can be erased; a line with one is not a command, as none has one.
    """

    def __init__(self) -> None:
        self._line: list[str] = []
        self._at = 0
        """Column of the cursor."""
        self._too_long = False
        self._junk = 0
        self._earlier: deque[str] = deque(maxlen=MAX_RECALLED_LINES)
        self._recalled = 0
        """Number of lines back to the earlier line that is shown; 0: no earlier line."""
        self._own = ""
        """The text typed before earlier lines were recalled."""

    def take(self, key: str | Key) -> bytes | str | BadLine:
        """Return the text to show, or the line that this key ended."""
        if isinstance(key, str):
            return self._insert(key)
        match key:
            case Key.ENTER:
                return self._end()
            case Key.JUNK_END:
                self._junk += _MIN_NOISE_KEYS
                return self._end()
            case Key.JUNK:
                self._junk += 1
            case Key.CANCEL:
                self._too_long, self._junk = False, 0
                return self._show("")
            case Key.UP | Key.DOWN:
                return self._recall(1 if key is Key.UP else -1)
            case Key.ERASE_WORD | Key.ERASE_BEFORE | Key.ERASE_BEHIND | Key.BACKSPACE | Key.DELETE:
                return self._erase(key)
            case Key.LEFT | Key.RIGHT | Key.HOME | Key.END:
                return self._move(self._place_of(key))
        return b""

    def shown(self) -> bytes:
        """The current line, for a terminal that redraws it."""
        return _ascii(self._line) + _BACK * (len(self._line) - self._at)

    def _insert(self, character: str) -> bytes:
        if len(self._line) == MAX_LINE_CHARACTERS:
            self._too_long = True
            return b""
        self._line.insert(self._at, character)
        self._at += 1
        behind = self._line[self._at :]
        return _ascii([character, *behind]) + _BACK * len(behind)

    def _end(self) -> str | BadLine:
        line, junk = "".join(self._line), self._junk
        bad = None
        if junk >= _MIN_NOISE_KEYS and 2 * junk >= len(line):
            bad = BadLine.NO_TEXT
        elif junk:
            bad = BadLine.STRAY
        elif self._too_long:
            bad = BadLine.TOO_LONG
        self._line.clear()
        self._at = self._junk = self._recalled = 0
        self._too_long = False
        if bad is not None:
            return bad
        if line.strip() and line not in list(self._earlier)[-1:]:
            self._earlier.append(line)
        return line

    def _place_of(self, key: Key) -> int:
        match key:
            case Key.LEFT | Key.BACKSPACE:
                return max(self._at - 1, 0)
            case Key.RIGHT | Key.DELETE:
                return min(self._at + 1, len(self._line))
            case Key.HOME | Key.ERASE_BEFORE:
                return 0
            case Key.ERASE_WORD:
                before = "".join(self._line[: self._at]).rstrip()
                return before.rfind(" ") + 1
        return len(self._line)

    def _erase(self, key: Key) -> bytes:
        if key is Key.ERASE_BEFORE:
            self._too_long, self._junk = False, 0
        begin, end = sorted((self._at, self._place_of(key)))
        count = end - begin
        moved = self._move(begin) if begin < self._at and end < len(self._line) else b""
        if not moved and begin < self._at:  # at the end of the line: as every terminal does for backspace
            del self._line[begin:end]
            self._at = begin
            return b"\b \b" * count
        del self._line[begin:end]
        behind = self._line[begin:]
        return moved + _ascii(behind) + b" " * count + _BACK * (len(behind) + count) if count else b""

    def _move(self, place: int) -> bytes:
        at, self._at = self._at, place
        return _BACK * (at - place) if place < at else _ascii(self._line[at:place])

    def _recall(self, by: int) -> bytes:
        recalled = self._recalled + by
        if not 0 <= recalled <= len(self._earlier):
            return b""
        if self._recalled == 0:
            self._own = "".join(self._line)
        self._recalled = recalled
        self._too_long, self._junk = False, 0
        return self._show(self._earlier[-recalled] if recalled else self._own)

    def _show(self, line: str) -> bytes:
        """Replace the line that is shown by another one."""
        cleared = self._move(len(self._line)) + b"\b \b" * len(self._line)
        self._line = list(line)
        self._at = len(line)
        return cleared + _ascii(self._line)


def _ascii(characters: list[str]) -> bytes:
    return "".join(characters).encode("ascii", "replace")
