"""A screen of characters with styles: text is cut between words, what does not take one cell is a ``?``."""

from __future__ import annotations

import re
import unicodedata
from enum import Enum, auto
from itertools import groupby


class Style(Enum):
    """The look of characters, as far as a terminal can."""

    PLAIN = auto()
    BOLD = auto()
    DIM = auto()
    GOOD = auto()
    WARNING = auto()
    BAD = auto()


Run = tuple[str, Style]
"""Characters of one style."""

BLOCKS_OF_UTF8 = "▁▂▃▄▅▆▇█"
LEVELS_OF_ASCII = "_.-^"

_BRAILLE = 0x2800
_DOT_BITS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Of a Braille pattern (Unicode 16.0, block 2800), by row and column."""
DOTS_ACROSS, DOTS_DOWN = 2, 4
"""Dots of a cell. A cell is about twice as high as it is wide, so that dots are in squares."""

_NUMBERS_AT_END = re.compile(r"(?:(?:^| +)[-+]?\d\S*)+$")


class Canvas:
    """``rows`` × ``columns`` cells; ``is_utf8``: the terminal shows blocks and Braille, else ASCII alone."""

    def __init__(self, rows: int, columns: int, *, is_utf8: bool) -> None:
        self.rows = rows
        self.columns = columns
        self.is_utf8 = is_utf8
        self._cells = [[(" ", Style.PLAIN)] * columns for _ in range(rows)]

    @property
    def levels(self) -> str:
        """Characters for heights, the lowest first."""
        return BLOCKS_OF_UTF8 if self.is_utf8 else LEVELS_OF_ASCII

    def put(
        self, row: int, column: int, text: str, style: Style = Style.PLAIN, width: int | None = None
    ) -> None:
        """Write from there to the right, over what is there; no more than ``width`` cells.

        Text that does not fit ends with an ellipsis behind its last whole word. That word is no number, for
        its unit would be missing.
        """
        if not (0 <= row < self.rows and 0 <= column < self.columns):
            return
        free = self.columns - column
        for offset, character in enumerate(self._cut(text, free if width is None else min(width, free))):
            self._cells[row][column + offset] = (self._shown(character), style)

    def dot(self, x: int, y: int, character: str, style: Style = Style.PLAIN) -> None:
        """Set the dot in column x and row y of dots; ``character`` is its cell in ASCII."""
        row, column = y // DOTS_DOWN, x // DOTS_ACROSS
        if not (0 <= row < self.rows and 0 <= column < self.columns):
            return
        if not self.is_utf8:
            self._cells[row][column] = (character, style)
            return
        bit = _DOT_BITS[y % DOTS_DOWN][x % DOTS_ACROSS]
        there = ord(self._cells[row][column][0])
        pattern = there - _BRAILLE if _BRAILLE <= there < _BRAILLE + 256 else 0
        self._cells[row][column] = (chr(_BRAILLE + (pattern | bit)), style)

    def runs(self) -> list[list[Run]]:
        """Each row as characters of one style after the other."""
        return [
            [
                ("".join(cell[0] for cell in cells), style)
                for style, cells in groupby(row, lambda cell: cell[1])
            ]
            for row in self._cells
        ]

    def text(self) -> str:
        """The characters alone, a line a row, without blanks at the ends."""
        return "\n".join("".join(cell[0] for cell in row).rstrip() for row in self._cells)

    def _cut(self, text: str, width: int) -> str:
        if len(text) <= width:
            return text
        ellipsis = "…" if self.is_utf8 else "..."
        whole = text[: max(width - len(ellipsis), 0)].rpartition(" ")[0].rstrip()
        return f"{_NUMBERS_AT_END.sub('', whole)} {ellipsis}".lstrip()[: max(width, 0)]

    def _shown(self, character: str) -> str:
        if character.isascii():
            return character if character.isprintable() else "?"
        if not self.is_utf8 or not character.isprintable() or unicodedata.combining(character):
            return "?"
        return "?" if unicodedata.east_asian_width(character) in "WF" else character
