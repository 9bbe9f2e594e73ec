"""A result's table as Markdown, aligned so that it reads well on a terminal too."""

from collections.abc import Sequence

from studies.result import Column, Result, Row, is_worse

WORSE = "**worse:**"


def table(result: Result) -> str:
    """A line ``thesis`` over a line ``ours`` for every row that the thesis has, else ``ours`` alone.

    The line of the thesis is written once for rows next to each other that have the same values of it.
    """
    beside = any(row.thesis is not None for row in result.rows)
    head = [result.of, *([""] if beside else []), *(column.name for column in result.columns)]
    lines = [head]
    before: Row | None = None
    for row in result.rows:
        repeated = before is not None and before.thesis == row.thesis
        lines += _lines(row, result, beside, repeated)
        before = row
    return aligned(lines, 2 if beside else 1)


def aligned(lines: Sequence[Sequence[str]], left: int) -> str:
    """A Markdown table with aligned columns: ``left`` columns of names, then numbers; the head is first."""
    widths = [max(3, *(len(line[place]) for line in lines)) for place in range(len(lines[0]))]
    rule = ["-" * width if place < left else "-" * (width - 1) + ":" for place, width in enumerate(widths)]
    padded = [
        [
            cell.ljust(width) if place < left else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(line, widths, strict=True))
        ]
        for line in lines
    ]
    padded.insert(1, rule)
    return "".join("|" + "|".join(line) + "|\n" for line in padded)


def _lines(row: Row, result: Result, beside: bool, repeated: bool) -> list[list[str]]:
    columns = result.columns
    ours = [_number(column, value) for column, value in zip(columns, row.ours, strict=True)]
    if row.thesis is None:
        return [[row.name, *(["ours"] if beside else []), *ours]]
    thesis = [_number(column, value) for column, value in zip(columns, row.thesis, strict=True)]
    marked = [
        f"{WORSE} {text}" if is_worse(column, value, other) else text
        for column, value, other, text in zip(columns, row.ours, row.thesis, ours, strict=True)
    ]
    if repeated:
        return [[row.name, "ours", *marked]]
    return [[row.name, result.beside, *thesis], ["", "ours", *marked]]


def _number(column: Column, value: float | None) -> str:
    return "–" if value is None else f"{value:.{column.digits}f}"
