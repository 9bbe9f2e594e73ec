from __future__ import annotations

import numpy as np
import pytest

from altd.mapping.grid import Axis, Block, Cell

GRID: list[Cell] = [(column, row) for row in range(5) for column in range(6)]


def row(number: int) -> list[Cell]:
    return [(column, number) for column in range(6)]


def column(number: int) -> list[Cell]:
    return [(number, row) for row in range(5)]


@pytest.mark.parametrize(
    ("missing", "columns", "rows", "left"),
    [
        ([], 6, 5, 0),
        (row(4), 6, 5, 6),  # a fifth of all may be missing wherever it is
        ([*row(4), (2, 2)], 6, 4, 1),
        ([*row(0), *column(5)], 6, 4, 4),  # the row goes, and the column is a sixth of what is left
        ([*column(0), *column(5)], 5, 5, 5),
        ([*column(0), *column(5), (2, 2)], 4, 5, 1),
        (row(2), 6, 5, 6),
    ],
)
def test_a_grid_without_outer_rows_that_are_missing_is_sufficient(
    missing: list[Cell], columns: int, rows: int, left: int
) -> None:
    block = Block.within(GRID, missing)
    assert (len(block.columns), len(block.rows), block.missing) == (columns, rows, left)
    assert block.is_sufficient


@pytest.mark.parametrize(
    "missing",
    [
        [*row(0), *row(4)],  # three rows bear no map
        [*column(0), *column(1), *column(5)],
        [(column, row) for column, row in GRID if (column + row) % 3 == 0],  # a third of it, everywhere
        GRID,
    ],
)
def test_too_little_is_not_sufficient(missing: list[Cell]) -> None:
    assert not Block.within(GRID, missing).is_sufficient


def test_an_axis_goes_through_a_row_that_is_missing() -> None:
    axis = Axis.through(np.array([-50.0, -25.0, 25.0, 50.0, 75.0]))
    assert (axis.first_mm, axis.step_mm, axis.nodes) == (-50.0, 25.0, 6)
    assert axis.numbers(np.array([25.3, -50.0])).tolist() == [3, 0]
