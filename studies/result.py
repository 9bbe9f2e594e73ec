"""The result of a study: a table with the thesis' figures beside ours, a figure, and the text."""

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

HARDER = ", hard"
"""The end of a row's name: the same on the harder simulator (docs/decisions/0005-simulator.md)."""

Progress = Callable[[str], None]
"""Called with a few words on what is being done."""


@dataclass(frozen=True, slots=True)
class Column:
    """One quantity, its unit in its name. Where ``judged``, more than the thesis is worse."""

    name: str
    digits: int = 4
    judged: bool = True


@dataclass(frozen=True, slots=True)
class Row:
    """One condition: a value a column, None where there is none. ``thesis`` is None for what it lacks."""

    name: str
    ours: tuple[float | None, ...]
    thesis: tuple[float | None, ...] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """``of`` heads the rows' names; ``thesis_source`` is the section, table or figure that is answered.

    ``headline`` is one sentence, ``text`` Markdown paragraphs, ``caption`` says what the figure shows.
    """

    of: str
    thesis_source: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    headline: str
    text: str
    figure: Figure
    caption: str
    differs: str = ""
    """Differences from the thesis' experiment, as clauses without a full stop; empty if it has none."""
    beside: str = "thesis"
    """The reference of our value: the thesis' measurement, or its specification."""

    def compared(self) -> list[tuple[str, str, bool]]:
        """Row, column and whether the thesis has the better value, of all that can be compared."""
        return [
            (row.name, column.name, is_worse(column, ours, thesis))
            for row in self.rows
            for column, ours, thesis in zip(self.columns, row.ours, row.thesis or (), strict=False)
            if column.judged and ours is not None and thesis is not None
        ]

    def worse(self) -> list[tuple[str, str]]:
        """Row and column of every value that the thesis bettered."""
        return [(row, column) for row, column, worse in self.compared() if worse]

    def hardened(self) -> list[tuple[str, str, float]]:
        """Row, column and ratio of all judged values of the harder simulator to those of the ordinary one."""
        ordinary = {row.name + HARDER: row.ours for row in self.rows}
        return [
            (row.name, column.name, hard / easy)
            for row in self.rows
            for column, easy, hard in zip(self.columns, ordinary.get(row.name, ()), row.ours, strict=False)
            if column.judged and easy and hard is not None
        ]


def is_worse(column: Column, ours: float | None, thesis: float | None) -> bool:
    """Whether the thesis has the better value, as printed: what rounds to the same is not worse."""
    if not column.judged or ours is None or thesis is None:
        return False
    return round(ours, column.digits) > round(thesis, column.digits)
