"""A result's table as Markdown, aligned so that it reads well on a terminal too."""

from __future__ import annotations

from studies.result import Column, Result, Row, is_worse

WORSE = "**worse:**"


def table(result: Result) -> str:
    """A line ``thesis`` over a line ``ours`` for every row that the thesis has, else ``ours`` alone."""
    beside = any(row.thesis is not None for row in result.rows)
    head = [result.of, *([""] if beside else []), *(column.name for column in result.columns)]
    lines = [head]
    for row in result.rows:
        lines += _lines(row, result, beside)
    widths = [max(len(line[place]) for line in lines) for place in range(len(head))]
    left = 2 if beside else 1  # names to the left, numbers to the right
    rule = [
        "-" * (width + 2) if place < left else "-" * (width + 1) + ":" for place, width in enumerate(widths)
    ]
    text = [
        "| "
        + " | ".join(
            cell.ljust(width) if place < left else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        + " |"
        for line in lines
    ]
    text.insert(1, "|" + "|".join(rule) + "|")
    return "\n".join(text) + "\n"


def _lines(row: Row, result: Result, beside: bool) -> list[list[str]]:
    columns = result.columns
    ours = [_number(column, value) for column, value in zip(columns, row.ours, strict=True)]
    if row.thesis is None:
        return [[row.name, *(["ours"] if beside else []), *ours]]
    thesis = [_number(column, value) for column, value in zip(columns, row.thesis, strict=True)]
    marked = [
        f"{WORSE} {text}" if is_worse(column, value, other) else text
        for column, value, other, text in zip(columns, row.ours, row.thesis, ours, strict=True)
    ]
    return [[row.name, result.beside, *thesis], ["", "ours", *marked]]


def _number(column: Column, value: float | None) -> str:
    return "–" if value is None else f"{value:.{column.digits}f}"
