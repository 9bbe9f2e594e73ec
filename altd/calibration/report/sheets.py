"""The report as a PDF: the document laid out on A4 sheets."""

from __future__ import annotations

import io
from collections.abc import Sequence
from datetime import datetime
from functools import lru_cache
from typing import Any

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.textpath import TextToPath

from altd.calibration.report.document import (
    WIDTH_IN,
    Banner,
    Block,
    Document,
    Heading,
    Level,
    Picture,
    Row,
    Table,
    Words,
)
from altd.calibration.report.html import MARKS
from altd.calibration.report.target_plots import FAINT, INK, QUIET, SizedFigure, report_style

_WIDTH_IN, _HEIGHT_IN = 8.27, 11.69
_MARGIN_IN, _TOP_IN, _BOTTOM_IN = 0.6, 0.6, 0.75
_ROOM_IN = _WIDTH_IN - 2 * _MARGIN_IN
_LEADING = 1.42
_CELL_GAP_IN = 0.12
_FILLS = {
    Level.GOOD: ("#eaf4fa", "#0072b2", "#005a8c"),
    Level.USABLE: ("#fdf5e3", "#e69f00", "#8a5a00"),
    Level.UNDECIDED: ("#fdf5e3", "#e69f00", "#8a5a00"),
    Level.BAD: ("#fcece3", "#d55e00", "#a84300"),
}
"""Colours of background, edge and words at each level."""


def pdf_sheets(document: Document, created: datetime) -> bytes:
    """Render the document as PDF; ``created`` is the creation time in the file's metadata."""
    with report_style():
        setter = _Setter()
        setter.words(document.title, 17, bold=True)
        setter.words(document.subtitle, 8.5, colour=QUIET)
        setter.gap(0.14)
        for index, block in enumerate(document.blocks):
            following = document.blocks[index + 1] if index + 1 < len(document.blocks) else None
            setter.block(block, following)
        return setter.pdf(document.title, document.mark, created)


class _Setter:
    """Places items below each other and starts a new sheet when there is no room."""

    def __init__(self) -> None:
        self._sheets: list[Figure] = []
        self._y_in = 0.0
        self._new_sheet()

    def pdf(self, title: str, mark: str, created: datetime) -> bytes:
        """Write all sheets, numbered and marked."""
        file = io.BytesIO()
        about = {"Title": title, "CreationDate": created, "Creator": "altd", "Producer": None}
        with PdfPages(file, metadata=about) as pdf:
            for number, sheet in enumerate(self._sheets, start=1):
                foot = 0.42 / _HEIGHT_IN
                sheet.text(_MARGIN_IN / _WIDTH_IN, foot, title, size=7, color=QUIET)
                words = f"{number} / {len(self._sheets)}"
                sheet.text(1 - _MARGIN_IN / _WIDTH_IN, foot, words, size=7, color=QUIET, ha="right")
                _mark(sheet, mark)
                pdf.savefig(sheet)
        return file.getvalue()

    def block(self, block: Block, following: Block | None) -> None:
        """Place a block; a heading stays with the following block."""
        match block:
            case Heading(text):
                self._heading(text, following)
            case Words(text):
                self.words(text, 8.5)
            case Banner():
                self._banner(block)
            case Table():
                self._table(block)
            case Row():
                self._row(block)

    def gap(self, height_in: float) -> None:
        """Leave vertical space."""
        self._y_in -= height_in

    def words(self, text: str, size: float, *, bold: bool = False, colour: str = INK) -> None:
        """Place a paragraph over the whole width."""
        for line in _lines(text, size, _ROOM_IN, bold):
            self._need(_height_in(size))
            self._put(line, _MARGIN_IN, size, bold, colour)
            self._y_in -= _height_in(size)

    def _new_sheet(self) -> None:
        self._sheets.append(Figure(figsize=(_WIDTH_IN, _HEIGHT_IN)))
        self._y_in = _HEIGHT_IN - _TOP_IN

    def _need(self, height_in: float) -> None:
        if self._y_in - height_in < _BOTTOM_IN:
            self._new_sheet()

    def _put(self, text: str, x_in: float, size: float, bold: bool, colour: str) -> None:
        place = x_in / _WIDTH_IN, (self._y_in - 0.8 * _height_in(size)) / _HEIGHT_IN
        weight = "bold" if bold else "normal"
        self._sheets[-1].text(*place, text, size=size, color=colour, fontweight=weight)

    def _rule(self, colour: str, y_in: float) -> None:
        ends = _MARGIN_IN / _WIDTH_IN, 1 - _MARGIN_IN / _WIDTH_IN
        line = Line2D(ends, (y_in / _HEIGHT_IN,) * 2, color=colour, linewidth=0.5)
        self._sheets[-1].add_artist(line)

    def _heading(self, text: str, following: Block | None) -> None:
        self.gap(0.24)
        match following:
            case Row():
                after_in = _tallest_in(_pairs(following)[0]) + _caption_in(following)
            case Table():
                after_in = _height_of_few_in(following)
            case _:
                after_in = 0.3
        self._need(0.3 + after_in)
        self._rule(FAINT, self._y_in + 0.06)
        self.words(text, 11.5, bold=True)
        self.gap(0.06)

    def _banner(self, banner: Banner) -> None:
        ground, edge, _ = _FILLS[banner.level]
        inner_in = _ROOM_IN - 0.4
        head = _lines(f"{MARKS[banner.level]} {banner.headline}", 12, inner_in, bold=True)
        body = [_lines(line, 8.5, inner_in, bold=False) for line in banner.lines]
        height_in = 0.2 + len(head) * _height_in(12)
        height_in += sum(0.06 + len(lines) * _height_in(8.5) for lines in body)
        self._need(height_in)
        for colour, width_in in ((ground, _ROOM_IN), (edge, 0.09)):
            corner = _MARGIN_IN / _WIDTH_IN, (self._y_in - height_in) / _HEIGHT_IN
            box = Rectangle(corner, width_in / _WIDTH_IN, height_in / _HEIGHT_IN, color=colour, linewidth=0)
            self._sheets[-1].add_artist(box)
        self.gap(0.1)
        for size, bold, lines in ((12, True, head), *((8.5, False, lines) for lines in body)):
            self.gap(0.0 if bold else 0.06)
            for line in lines:
                self._put(line, _MARGIN_IN + 0.25, size, bold, INK)
                self._y_in -= _height_in(size)
        self.gap(0.2)

    def _table(self, table: Table) -> None:
        self._need(_height_of_few_in(table))
        self.gap(0.06)
        starts = [_MARGIN_IN + _ROOM_IN * sum(table.shares[:n]) for n in range(len(table.shares))]
        if any(table.columns):
            self._line(table, starts, table.columns, None, head=True)
        for number, row in enumerate(table.rows):
            self._line(table, starts, row, table.levels[number] if table.levels else None, head=False)
        self.gap(0.08)

    def _line(
        self, table: Table, starts: list[float], row: tuple[str, ...], level: Level | None, *, head: bool
    ) -> None:
        """Place one row of a table, with as many lines of type as its longest cell needs."""
        size = 7.5
        cells = list(row)
        if level is not None:
            cells[-1] = f"{MARKS[level]} {cells[-1]}"
        set_cells = [
            _lines(cell, size, _ROOM_IN * share - _CELL_GAP_IN, head)
            for cell, share in zip(cells, table.shares, strict=True)
        ]
        height_in = max(len(lines) for lines in set_cells) * _height_in(size) + 0.07
        if not head and self._y_in - height_in < _BOTTOM_IN:
            self._new_sheet()
            if any(table.columns):
                self._line(table, starts, table.columns, None, head=True)
        self._need(height_in)
        top_in = self._y_in
        for place, (lines, start_in) in enumerate(zip(set_cells, starts, strict=True)):
            judged = level is not None and place == len(cells) - 1
            colour = _FILLS[level][2] if judged and level is not None else QUIET if head else INK
            self._y_in = top_in - 0.03
            for line in lines:
                self._put(line, start_in, size, head or judged, colour)
                self._y_in -= _height_in(size)
        self._y_in = top_in - height_in
        self._rule(QUIET if head else FAINT, self._y_in)

    def _row(self, row: Row) -> None:
        """Place two pictures side by side, more of them below; the caption stays with the last."""
        pairs = _pairs(row)
        for pair in pairs:
            height_in = _tallest_in(pair)
            self._need(height_in + 0.12 + (_caption_in(row) if pair is pairs[-1] else 0.0))
            self.gap(0.06)
            for picture, left_in in zip(pair, (_MARGIN_IN, _WIDTH_IN - _MARGIN_IN - WIDTH_IN), strict=False):
                self._picture(picture, left_in)
            self.gap(height_in + 0.04)
        if row.caption:
            self.words(row.caption, 8, colour="#444b54")
            self.gap(0.06)

    def _picture(self, picture: Picture, left_in: float) -> None:
        """Draw into the middle cell of a grid whose other cells are the surrounding space."""
        right_in, below_in = _WIDTH_IN - left_in - WIDTH_IN, self._y_in - picture.height_in
        grid = self._sheets[-1].add_gridspec(
            3, 3, left=0, right=1, bottom=0, top=1, wspace=0, hspace=0,
            width_ratios=(left_in, WIDTH_IN, right_in),
            height_ratios=(_HEIGHT_IN - self._y_in, picture.height_in, below_in),
        )  # fmt: skip
        picture.draw(SizedFigure(self._sheets[-1].add_subfigure(grid[1, 1]), WIDTH_IN, picture.height_in))


def _mark(sheet: Figure, mark: str) -> None:
    """Print the mark large and pale across the sheet, over its content, and small and dark at its head."""
    _, edge, dark = _FILLS[Level.BAD]
    middle: dict[str, Any] = {"ha": "center", "va": "center", "fontweight": "bold"}
    sheet.text(0.5, 0.5, mark, size=96, rotation=54, color=edge, alpha=0.14, zorder=1000, **middle)
    sheet.text(0.5, 1 - 0.36 / _HEIGHT_IN, mark, size=9, color=dark, **middle)


def _height_of_few_in(table: Table) -> float:
    """Height to reserve for a table that stays in one piece, or for the first lines of a longer one."""
    return 0.35 * (1 + min(len(table.rows), 3)) if len(table.rows) > 6 else 0.3 * (1 + len(table.rows))


def _pairs(row: Row) -> list[tuple[Picture, ...]]:
    return [row.pictures[n : n + 2] for n in range(0, len(row.pictures), 2)]


def _tallest_in(pictures: Sequence[Picture]) -> float:
    return max(picture.height_in for picture in pictures)


def _caption_in(row: Row) -> float:
    return len(_lines(row.caption, 8, _ROOM_IN, bold=False)) * _height_in(8) if row.caption else 0.0


def _height_in(size: float) -> float:
    return size * _LEADING / 72


@lru_cache(maxsize=1000)
def _lines(text: str, size: float, room_in: float, bold: bool) -> tuple[str, ...]:
    """Break the text between words, and within a word that is wider than the room."""
    space_in = _width_in("n n", size, bold) - 2 * _width_in("n", size, bold)
    lines: list[str] = [""]
    used_in = 0.0
    for word in text.split():
        width_in = _width_in(word, size, bold)
        if lines[-1] and used_in + space_in + width_in <= room_in:
            lines[-1] += f" {word}"
            used_in += space_in + width_in
            continue
        if lines[-1]:
            lines.append("")
        *broken, last = _broken(word, size, room_in, bold)
        lines[-1:] = [*broken, last]
        used_in = _width_in(last, size, bold)
    return tuple(lines)


def _broken(word: str, size: float, room_in: float, bold: bool) -> list[str]:
    """Break a word into parts that fit, such as a checksum in a narrow column."""
    parts = [word]
    while len(parts[-1]) > 1 and _width_in(parts[-1], size, bold) > room_in:
        long = parts.pop()
        fitting = next(
            n for n in range(len(long) - 1, 0, -1) if n == 1 or _width_in(long[:n], size, bold) <= room_in
        )
        parts += [long[:fitting], long[fitting:]]
    return parts


_TYPE = TextToPath()


@lru_cache(maxsize=5000)
def _width_in(text: str, size: float, bold: bool) -> float:
    font = FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal", size=size)
    width, _, _ = _TYPE.get_text_width_height_descent(text, font, ismath=False)
    return float(width) / 72
