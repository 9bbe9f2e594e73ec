"""A screen of styled characters, and drawings on it: a target with the path of its spot, a trend.

Text is cut between words; a character that does not take one cell is shown as ``?``.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from itertools import groupby

from altd.errors import shown_in
from altd.terminal.documents import TargetsDocument


class Style(Enum):
    """Style of characters, as far as a terminal supports it."""

    PLAIN = auto()
    BOLD = auto()
    DIM = auto()
    GOOD = auto()
    WARNING = auto()
    BAD = auto()


Run = tuple[str, Style]
"""Consecutive characters of one style."""

BLOCKS_OF_UTF8 = "▁▂▃▄▅▆▇█"
LEVELS_OF_ASCII = "_.-^"

_BRAILLE = 0x2800
_DOT_BITS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bits of a Braille pattern (Unicode 16.0, block 2800), by row and column."""
DOTS_ACROSS, DOTS_DOWN = 2, 4
"""Dots per cell. A cell is about twice as high as it is wide, so that dots form squares."""

_NUMBERS_AT_END = re.compile(r"(?:(?:^| +)[-+]?\d\S*)+$")


class Canvas:
    """``rows`` × ``columns`` cells; ``is_utf8``: the terminal shows blocks and Braille, else only ASCII."""

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
        """Write from there to the right, over existing text; at most ``width`` cells.

        Text that does not fit ends with an ellipsis after its last whole word. Numbers before the ellipsis
        are removed, because their unit would be missing.
        """
        if not (0 <= row < self.rows and 0 <= column < self.columns):
            return
        text = text if self.is_utf8 else shown_in("ascii", text)
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
        """Return each row as runs of characters of one style."""
        return [
            [
                ("".join(cell[0] for cell in cells), style)
                for style, cells in groupby(row, lambda cell: cell[1])
            ]
            for row in self._cells
        ]

    def text(self) -> str:
        """Return the characters without styles, one line per row, without trailing blanks."""
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


_MIN_SIGMAS = 6.0
"""Minimum height of a trend in standard deviations; with less, noise would look like motion."""


def limits_of(values: Sequence[float | None], sigma: float | None) -> tuple[float, float] | None:
    """Values of the lowest and the highest level; None: no value is known."""
    known = [value for value in values if value is not None]
    if not known:
        return None
    low, high = min(known), max(known)
    missing = max((sigma or 0.0) * _MIN_SIGMAS - (high - low), 0.0)
    if high - low + missing == 0.0:
        missing = 1.0
    return low - missing / 2, high + missing / 2


def draw_trend(
    canvas: Canvas, row: int, column: int, rows: int, values: Sequence[float | None], sigma: float | None
) -> None:
    """Draw one column per value, the last at the right; with more than one row, filled from below."""
    limits = limits_of(values, sigma)
    if limits is None:
        return
    low, high = limits
    levels = canvas.levels if rows == 1 or canvas.is_utf8 else "#"
    for offset, value in enumerate(values):
        if value is None:
            continue
        height = min(math.floor((value - low) / (high - low) * rows * len(levels)), rows * len(levels) - 1)
        full, top = divmod(height, len(levels))
        for below in range(full):
            canvas.put(row + rows - 1 - below, column + offset, levels[-1], Style.PLAIN)
        canvas.put(row + rows - 1 - full, column + offset, levels[top], Style.PLAIN)


Place = tuple[float, float]
"""Position, mm: x to the right and y upwards."""

SPOT = "O"
_OUTLINE, _PATH, _CORNER, _MIDDLE = ".", ":", "+", "+"
_FREE_SHARE = 1.04
"""Ratio of the picture's size to that of its content."""


@dataclass(frozen=True, slots=True)
class PlotCells:
    """Cells of a canvas, and the mm of a target per dot; the unit's zero is in their middle."""

    row: int
    column: int
    rows: int
    columns: int
    mm_per_dot: float

    @classmethod
    def holding(cls, targets: TargetsDocument, row: int, column: int, rows: int, columns: int) -> PlotCells:
        """Return the frame with the largest scale at which every target fits into these cells."""
        width, height = half_size_mm(targets)
        scale = max(2 * width / (columns * DOTS_ACROSS), 2 * height / (rows * DOTS_DOWN))
        return cls(row, column, rows, columns, scale)

    def dot_of(self, place: Place) -> tuple[int, int]:
        """Column and row of dots on the canvas."""
        x = (self.column + self.columns / 2) * DOTS_ACROSS + place[0] / self.mm_per_dot
        y = (self.row + self.rows / 2) * DOTS_DOWN - place[1] / self.mm_per_dot
        return math.floor(x), math.floor(y)

    def cell_of(self, place: Place) -> tuple[int, int]:
        """Row and column on the canvas."""
        x, y = self.dot_of(place)
        return y // DOTS_DOWN, x // DOTS_ACROSS

    def holds(self, place: Place) -> bool:
        """Whether the place is in these cells."""
        row, column = self.cell_of(place)
        return self.row <= row < self.row + self.rows and self.column <= column < self.column + self.columns


def half_size_mm(targets: TargetsDocument) -> Place:
    """Half width and half height of the area that must be visible of every target, mm."""
    corners = [corner for target in targets.targets for corner in target.valid_mm]
    width = max([targets.area_mm[0] / 2, *(abs(x) for x, _ in corners)])
    height = max([targets.area_mm[1] / 2, *(abs(y) for _, y in corners)])
    return width * _FREE_SHARE, height * _FREE_SHARE


def rows_for(targets: TargetsDocument, columns: int) -> int:
    """Number of rows of a picture with this width."""
    width, height = half_size_mm(targets)
    return math.ceil(columns * DOTS_ACROSS * height / width / DOTS_DOWN)


def draw_target(
    canvas: Canvas,
    frame: PlotCells,
    targets: TargetsDocument,
    name: str,
    path: Sequence[Place],
    spot: Place | None,
) -> None:
    """Draw one target into a frame; ``path`` and ``spot`` are the known positions of its laser spot."""
    half_width, half_height = targets.area_mm[0] / 2, targets.area_mm[1] / 2
    corners = [(x, y) for x in (-half_width, half_width) for y in (-half_height, half_height)]
    outline = next((target.valid_mm for target in targets.targets if target.name == name), ())
    _dots(canvas, frame, _along(outline, frame.mm_per_dot), _OUTLINE, Style.DIM)
    for place, mark in [*((corner, _CORNER) for corner in corners), ((0.0, 0.0), _MIDDLE)]:
        canvas.put(*frame.cell_of(place), mark, Style.DIM)
    _dots(canvas, frame, path, _PATH, Style.PLAIN)
    if spot is not None and frame.holds(spot):
        canvas.put(*frame.cell_of(spot), SPOT, Style.GOOD)


def _dots(canvas: Canvas, frame: PlotCells, places: Iterable[Place], character: str, style: Style) -> None:
    for place in places:
        if frame.holds(place):
            canvas.dot(*frame.dot_of(place), character, style)


def _along(corners: Sequence[Place], step_mm: float) -> Iterable[Place]:
    """Yield places along a closed line, at most one dot apart."""
    for (x, y), (next_x, next_y) in zip(corners, [*corners[1:], *corners[:1]], strict=True):
        steps = min(math.ceil(math.hypot(next_x - x, next_y - y) / step_mm) + 1, _MAX_STEPS)
        for step in range(steps):
            share = step / steps
            yield x + share * (next_x - x), y + share * (next_y - y)


_MAX_STEPS = 1000
"""Maximum number of dots of one edge: more than any screen has."""
