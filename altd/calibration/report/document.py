"""The report before its layout: headings, words, tables and pictures, the same for HTML and PDF."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from altd.calibration.report.target_plots import SizedFigure


WIDTH_IN = 3.45
"""Width of every picture: two fill a sheet, one a phone, and the type in them is legible on either."""


class Level(IntEnum):
    """The grade of a check; a calibration is as good as its worst check."""

    GOOD = 0
    USABLE = 1
    UNDECIDED = 2
    BAD = 3

    @property
    def word(self) -> str:
        """Name of the level as printed."""
        return ("good", "usable", "not decided", "not good")[self]


@dataclass(frozen=True, slots=True)
class Heading:
    """The heading of a section."""

    text: str


@dataclass(frozen=True, slots=True)
class Words:
    """A paragraph."""

    text: str


@dataclass(frozen=True, slots=True)
class Banner:
    """A prominent message with a level, such as the verdict."""

    level: Level
    headline: str
    lines: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """A table; ``columns`` are the headings, none for names and values; ``shares`` of the width sum to 1.

    ``levels`` has one level per row if rows are judged, else it is empty.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    shares: tuple[float, ...]
    levels: tuple[Level, ...] = ()


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawing ``WIDTH_IN`` wide; ``words`` is the alternative text."""

    words: str
    height_in: float
    draw: Callable[[SizedFigure], None] = field(repr=False)


@dataclass(frozen=True, slots=True)
class Row:
    """Pictures to be compared, side by side if there is room."""

    pictures: tuple[Picture, ...]
    caption: str


Block = Heading | Words | Banner | Table | Row


@dataclass(frozen=True, slots=True)
class Document:
    """The whole report on the calibration whose file contains ``checksum``.

    ``mark`` is printed across every sheet; empty: no mark.
    """

    title: str
    subtitle: str
    blocks: tuple[Block, ...]
    checksum: str
    mark: str = ""
