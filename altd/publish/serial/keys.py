"""Converts the bytes of a terminal to keys: UTF-8, escape sequences (ECMA-48), telnet commands, pasted text.

A key that sends a sequence is one key, known or not, however its bytes are split over reads; no part of a
sequence becomes text. An unfinished sequence is dropped after ``waiting_s`` of silence, and with Enter.
"""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from enum import Enum, auto

ESCAPE_TIMEOUT_S = 0.15
"""Time of silence after which ESC alone was the key: longer than a byte takes at 1200 baud, shorter than
anybody types."""
SEQUENCE_TIMEOUT_S = 0.5
"""Time after which an unfinished sequence is dropped; a terminal server may hold a part of it back."""
PASTE_TIMEOUT_S = 2.0
"""Time after which a bracketed paste without its end is given up."""
MAX_SEQUENCE = 16
"""Maximum number of stored characters of a sequence: no key sends more. Longer sequences are unknown."""
MAX_TELNET = 64
"""Maximum number of bytes of a telnet command; a longer one is dropped."""


class Key(Enum):
    """Input of a terminal that is not a character."""

    ENTER = auto()
    BACKSPACE = auto()
    DELETE = auto()
    LEFT = auto()
    RIGHT = auto()
    UP = auto()
    DOWN = auto()
    HOME = auto()
    END = auto()
    ERASE_WORD = auto()
    ERASE_BEFORE = auto()
    ERASE_BEHIND = auto()
    CANCEL = auto()
    REDRAW = auto()
    OTHER = auto()
    """A key that has no function here."""
    JUNK = auto()
    """A byte that no key sends: a character of an 8-bit code, or noise."""
    JUNK_END = auto()
    """Enter as sent by a terminal with seven data bits and even parity."""


_ESC, _BEL, _CAN, _SUB, _DEL = "\x1b", "\x07", "\x18", "\x1a", "\x7f"
_CSI_8_BIT, _SS3_8_BIT = "\udc9b", "\udc8f"  # as surrogateescape decodes the bytes 9B and 8F
_JUNK_ENDS = "\udc8d\udc8a"
_STRINGS = "]PX^_"  # OSC, DCS, SOS, PM, APC
_CONTROLS = {
    "\x01": Key.HOME,
    "\x02": Key.LEFT,
    "\x03": Key.CANCEL,
    "\x04": Key.DELETE,
    "\x05": Key.END,
    "\x06": Key.RIGHT,
    "\x08": Key.BACKSPACE,
    "\x0b": Key.ERASE_BEHIND,
    "\x0c": Key.REDRAW,
    "\x0e": Key.DOWN,
    "\x10": Key.UP,
    "\x15": Key.ERASE_BEFORE,
    "\x17": Key.ERASE_WORD,
    _DEL: Key.BACKSPACE,
}
_FINALS = {
    "A": Key.UP,
    "B": Key.DOWN,
    "C": Key.RIGHT,
    "D": Key.LEFT,
    "F": Key.END,
    "H": Key.HOME,
}
_TILDES = {
    "1": Key.HOME,
    "3": Key.DELETE,
    "4": Key.END,
    "7": Key.HOME,
    "8": Key.END,
}
_REPORTS = "IMORcmnty"
"""Final characters of reports that a terminal sends without a key: focus, mouse, cursor, identity."""
_PASTE_BEGINS, _PASTE_ENDS = "200~", "201~"


_IAC, _SB, _SE = 255, 250, 240
_MAX_OPTION = 49
"""The largest telnet option that is assigned and in use."""


class _In(Enum):
    """Position of the next character in the stream."""

    TEXT = auto()
    ESCAPE = auto()
    """After ESC, and after the intermediate characters of an escape sequence."""
    CSI = auto()
    SS3 = auto()
    STRING = auto()
    FUNCTION = auto()
    """After ESC [ [, with which the Linux console begins F1 to F5."""
    MOUSE = auto()
    """In the three characters after ESC [ M."""


class KeyReader:
    """Takes one byte at a time and yields the keys that it completes: printable characters, and ``Key``."""

    def __init__(self) -> None:
        self._telnet = _Telnet()
        self._decoder = codecs.getincrementaldecoder("utf-8")("surrogateescape")
        self._in = _In.TEXT
        self._sequence = ""
        self._left = 0
        self._pasting = False
        self._after_cr = False
        self._line_of_seven_bits = self._seven_bits = True
        """Whether all bytes since the last line end are characters except for their eighth bit."""

    @property
    def waiting_s(self) -> float | None:
        """Time of silence until ``rest`` is due; None: nothing is open."""
        if self._in is not _In.TEXT:
            return ESCAPE_TIMEOUT_S if self._in is _In.ESCAPE else SEQUENCE_TIMEOUT_S
        if self._telnet.is_open or self._decoder.getstate()[0]:
            return SEQUENCE_TIMEOUT_S
        return PASTE_TIMEOUT_S if self._pasting else None

    def take(self, byte: int) -> Iterator[str | Key]:
        """Yield the keys that end with this byte."""
        self._seven_bits = self._line_of_seven_bits
        self._line_of_seven_bits = byte & 0x7F in b"\r\n" or (self._seven_bits and 0x20 <= byte & 0x7F < 0x7F)
        for data in self._telnet.take(byte):
            yield from self._keys(self._decoder.decode(bytes([data])))

    def rest(self) -> Iterator[str | Key]:
        """Drop what is open after ``waiting_s`` without input; ESC alone was a key."""
        alone = self._in is _In.ESCAPE and not self._sequence
        self._telnet.discard()
        self._in = _In.TEXT
        self._pasting = False
        yield from self._keys(self._decoder.decode(b"", final=True))
        if alone:
            yield Key.OTHER

    def _keys(self, characters: str) -> Iterator[str | Key]:
        for character in characters:
            key = self._key(character)
            if key is not None and not (self._pasting and isinstance(key, Key) and key is not Key.JUNK):
                yield key

    def _key(self, character: str) -> str | Key | None:
        after_cr, self._after_cr = self._after_cr, character == "\r"
        if character in (_ESC, _CAN, _SUB):
            self._begin(_In.ESCAPE if character == _ESC else _In.TEXT)
            return None
        if character in "\r\n":
            self._in = _In.TEXT
            if self._pasting:
                return " "
            return None if after_cr and character == "\n" else Key.ENTER
        match self._in:
            case _In.TEXT:
                return self._plain(character)
            case _In.ESCAPE:
                return self._escaped(character)
            case _In.CSI | _In.SS3:
                return self._sequenced(character)
        return self._passed_over(character)

    def _passed_over(self, character: str) -> Key | None:
        """Skip a character without meaning here: of a string, a mouse position, the number of F1 to F5."""
        if self._in is _In.STRING:
            self._in = _In.TEXT if character == _BEL else _In.STRING
            return None
        self._left -= 1
        if self._left:
            return None
        state, self._in = self._in, _In.TEXT
        return Key.OTHER if state is _In.FUNCTION else None

    def _begin(self, state: _In) -> None:
        self._in = state
        self._sequence = ""

    def _plain(self, character: str) -> str | Key | None:
        if character in (_CSI_8_BIT, _SS3_8_BIT):
            self._begin(_In.CSI if character == _CSI_8_BIT else _In.SS3)
            return None
        if "\udc80" <= character <= "\udcff":
            return Key.JUNK_END if character in _JUNK_ENDS and self._seven_bits else Key.JUNK
        if character.isprintable():
            return character
        if character == "\0":
            return None  # a break, or padding
        if (character > _DEL and character.isspace()) or (self._pasting and character == "\t"):
            return " "
        return _CONTROLS.get(character, Key.OTHER)

    def _escaped(self, character: str) -> str | Key | None:
        """Process a character after ESC: ECMA-48, 5.3 and 5.4, and ECMA-35, 13."""
        if not self._sequence and character == "[":
            self._begin(_In.CSI)
            return None
        if not self._sequence and character == "O":
            self._begin(_In.SS3)
            return None
        if not self._sequence and character in _STRINGS:
            self._begin(_In.STRING)
            return None
        if " " <= character <= "/":
            self._sequence = " "
            return None
        self._in = _In.TEXT
        if character in "\b\x7f" and not self._sequence:
            return Key.ERASE_WORD
        return Key.OTHER if "0" <= character <= "~" else self._plain(character)

    def _sequenced(self, character: str) -> str | Key | None:
        """Process a character of a control sequence (ECMA-48, 5.4), or a character after SS3."""
        if " " <= character <= "?":
            if len(self._sequence) <= MAX_SEQUENCE:
                self._sequence += character
            return None
        state, self._in = self._in, _In.TEXT
        if not "@" <= character <= "~":
            return self._plain(character)
        if state is _In.SS3:
            return Key.OTHER if self._sequence else _FINALS.get(character, Key.OTHER)
        if not self._sequence and character == "[":
            self._in, self._left = _In.FUNCTION, 1
            return None
        if not self._sequence and character == "M":
            self._in, self._left = _In.MOUSE, 3
            return None
        whole = self._sequence + character
        if whole in (_PASTE_BEGINS, _PASTE_ENDS):
            self._pasting = whole == _PASTE_BEGINS
            return None
        if character in _REPORTS or self._sequence[:1] in ("<", "=", ">", "?"):
            return None
        if character == "~":
            return _TILDES.get(self._sequence, Key.OTHER)
        return Key.OTHER if self._sequence not in ("", "1") else _FINALS.get(character, Key.OTHER)


class _Telnet:
    """Removes the commands of RFC 854 from the stream, in which a terminal server may leave them."""

    def __init__(self) -> None:
        self._command = bytearray()

    @property
    def is_open(self) -> bool:
        """Whether a command is incomplete."""
        return bool(self._command)

    def discard(self) -> None:
        """Drop an incomplete command."""
        self._command.clear()

    def take(self, byte: int) -> bytes:
        """Return the part of the stream up to this byte that is not telnet. An IAC may be text."""
        command = self._command
        if not command and byte != _IAC:
            return bytes([byte])
        command.append(byte)
        whole = bytes(command)
        if byte in b"\r\n":  # Enter ends everything
            command.clear()
            return whole[-1:] if whole[1] == _SB else whole
        if len(whole) == 1 or (len(whole) == 2 and _SB < whole[1] < _IAC):
            return b""
        if whole[1] == _SB:
            if whole[-2:] == bytes([_IAC, _SE]) or len(whole) == MAX_TELNET:
                command.clear()
            return b""
        command.clear()
        known = _SE <= whole[1] < _SB or (len(whole) == 3 and whole[2] <= _MAX_OPTION)
        return b"" if known else whole
