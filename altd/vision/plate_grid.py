"""Which found LED is which of the plate's grid: neighbours are followed from one to the next.

A full grid looks the same upside down, and mirrored but for the side of its columns. So two things are taken
as known: whether the camera sees the target mirrored, and that up in the picture is up (+y), to within
``LARGEST_TURN_DEG``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from altd.records import FloatArray

LARGEST_TURN_DEG = 30.0

Cell = tuple[int, int]

_SEEDS = 9
_NEIGHBOURS = 6
_REACH = 0.3
"""A neighbour lies within this share of a step of where the step before it points."""
_OFF_SHARE = 0.2
"""The same for a smooth map through all the others."""
_FEWEST_FOR_CUBIC = 16
_LEAST_LEFT = 0.08
"""A point that the cubic follows more closely than so is on its own: no other tells whether it is right."""
_LEAST_SHARE = 0.5
_CLEAR_BY = 2
"""By so many LEDs the grid must fit better than shifted by a line."""


@dataclass(frozen=True, slots=True, eq=False)
class GridMatch:
    """``rows_of`` (rows, columns) holds the row of the point that is the LED there, −1 where there is none.

    Counted from the LED with the smallest x and the smallest y. ``extra`` are points that are no LED.
    """

    rows_of: npt.NDArray[np.int64]
    extra: tuple[int, ...]


def match_grid(points_px: FloatArray, columns: int, rows: int, mirrored: bool) -> GridMatch:
    """Match points (n, 2) px to a grid of columns × rows, some of them missing, some points false.

    Raises ValueError, in words for the user, when they are no such grid or their place in it cannot be told.
    """
    cells = _largest_lattice(points_px, columns, rows)
    if len(cells) < max(_LEAST_SHARE * columns * rows, 6):
        raise ValueError(f"of {len(points_px)} lights only {len(cells)} lie on a grid")
    _correct(points_px, cells)
    _fill_gaps(points_px, cells)
    _correct(points_px, cells)
    upright = _turned_upright(points_px, cells, mirrored)
    placed = _placed(upright, columns, rows)
    extra = sorted(set(range(len(points_px))) - set(placed[placed >= 0].tolist()))
    return GridMatch(placed, tuple(extra))


def _largest_lattice(points: FloatArray, columns: int, rows: int) -> dict[Cell, int]:
    """The lattice that holds most points within a window of the grid's size, lying or standing."""
    best: dict[Cell, int] = {}
    best_count = 0
    if len(points) < 4:
        return best
    middle = np.median(points, axis=0)
    for seed in np.argsort(np.linalg.norm(points - middle, axis=1))[:_SEEDS].tolist():
        off = points - points[seed]
        near = np.argsort(np.linalg.norm(off, axis=1))[1 : _NEIGHBOURS + 1].tolist()
        for at, first in enumerate(near):
            for second in near[at + 1 :]:
                a, b = off[first], off[second]
                sine = abs(a[0] * b[1] - a[1] * b[0]) / (np.linalg.norm(a) * np.linalg.norm(b))
                if sine < 0.6:
                    continue
                cells = _grown(points, seed, a, b)
                count = max(_most_in(cells, columns, rows), _most_in(cells, rows, columns))
                if count > best_count:
                    best, best_count = cells, count
                if count == min(columns * rows, len(points)):
                    return best
    return best


def _grown(points: FloatArray, seed: int, a: FloatArray, b: FloatArray) -> dict[Cell, int]:
    """Follow the steps from neighbour to neighbour; each is taken from the nearest pair that is known."""
    cells: dict[Cell, int] = {(0, 0): seed}
    free = np.ones(len(points), dtype=bool)
    free[seed] = False
    queue = deque([(0, 0)])
    while queue:
        at = queue.popleft()
        for direction, first in (((1, 0), a), ((-1, 0), -a), ((0, 1), b), ((0, -1), -b)):
            to = at[0] + direction[0], at[1] + direction[1]
            if to in cells:
                continue
            step = _step(points, cells, at, direction)
            step = first if step is None else step
            miss = np.linalg.norm(points - (points[cells[at]] + step), axis=1)
            miss[~free] = np.inf
            nearest = int(miss.argmin())
            if miss[nearest] < _REACH * np.linalg.norm(step):
                cells[to] = nearest
                free[nearest] = False
                queue.append(to)
    return cells


def _step(points: FloatArray, cells: Mapping[Cell, int], at: Cell, direction: Cell) -> FloatArray | None:
    """The step from a cell as its neighbours know it: the one before it, else one beside it."""
    i, j = at
    di, dj = direction
    before = cells.get((i - di, j - dj))
    if before is not None:
        return np.asarray(points[cells[at]] - points[before])
    beside = [(i + dj, j + di), (i - dj, j - di)]
    pairs = [(cells.get(cell), cells.get((cell[0] + di, cell[1] + dj))) for cell in beside]
    steps = [points[end] - points[start] for start, end in pairs if start is not None and end is not None]
    return np.asarray(np.mean(steps, axis=0)) if steps else None


def _most_in(cells: Mapping[Cell, int], columns: int, rows: int) -> int:
    """Most cells that a window of columns × rows can hold."""
    return max(count for count, _, _ in _windows(cells, columns, rows))


def _windows(cells: Mapping[Cell, int], columns: int, rows: int) -> list[tuple[int, int, int]]:
    """How many cells each window (first column, first row) of that size holds, most first."""
    places = np.array(list(cells))
    low, high = places.min(axis=0), places.max(axis=0)
    full = np.zeros(high - low + 2 * np.array([columns, rows]) - 1, dtype=np.int64)
    full[tuple((places - low + np.array([columns, rows]) - 1).T)] = 1
    sums = np.zeros((full.shape[0] + 1, full.shape[1] + 1), dtype=np.int64)
    sums[1:, 1:] = full.cumsum(axis=0).cumsum(axis=1)
    counts = sums[columns:, rows:] - sums[:-columns, rows:] - sums[columns:, :-rows] + sums[:-columns, :-rows]
    first_i, first_j = low[0] - columns + 1, low[1] - rows + 1
    return sorted(
        ((int(count), int(first_i + i), int(first_j + j)) for (i, j), count in np.ndenumerate(counts)),
        reverse=True,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Smooth:
    """A cubic through the lattice's points: cell → px."""

    centre: FloatArray
    scale: float
    coefficients: FloatArray
    left_out_px: FloatArray
    """Where the others put each point of the lattice, (n, 2); NaN where they do not tell."""

    @classmethod
    def through(cls, points: FloatArray, cells: Mapping[Cell, int]) -> Self:
        """Least squares, with the leverage taken out of each point's own residual."""
        places = np.array(list(cells), dtype=np.float64)
        seen = points[list(cells.values())]
        centre, scale = places.mean(axis=0), float(np.ptp(places, axis=0).max() / 2)
        design = _cubic((places - centre) / scale)
        inverse = np.linalg.pinv(design)
        coefficients = inverse @ seen
        left = 1 - np.einsum("nk,kn->n", design, inverse)[:, None]
        left = np.where(left < _LEAST_LEFT, np.nan, left)
        return cls(centre, scale, coefficients, seen - (seen - design @ coefficients) / left)

    def to_px(self, cells: npt.ArrayLike) -> FloatArray:
        """Where cells (n, 2) lie."""
        places = np.asarray(cells, dtype=np.float64)
        return np.asarray(_cubic((places - self.centre) / self.scale) @ self.coefficients)

    def step_px(self, cell: Cell) -> float:
        """The shorter step from a cell to the next ones."""
        here, right, up = self.to_px([cell, (cell[0] + 1, cell[1]), (cell[0], cell[1] + 1)])
        return float(min(np.linalg.norm(right - here), np.linalg.norm(up - here)))


def _cubic(q: FloatArray) -> FloatArray:
    """All monomials up to total degree 3 of points (n, 2)."""
    return np.stack([q[:, 0] ** i * q[:, 1] ** j for i in range(4) for j in range(4 - i)], axis=-1)


def _correct(points: FloatArray, cells: dict[Cell, int]) -> None:
    """Take the worst point off its cell as long as the others put the LED there elsewhere.

    A light beside an LED, or in the place of a dark one, may be what the steps met first.
    """
    for _ in range(2 * len(points)):
        if len(cells) < _FEWEST_FOR_CUBIC:
            return
        smooth = _Smooth.through(points, cells)
        off_px = np.linalg.norm(points[list(cells.values())] - smooth.left_out_px, axis=1)
        shares = off_px / np.array([smooth.step_px(cell) for cell in cells])
        at = int(np.where(np.isnan(shares), np.inf, shares).argmax())
        cell = list(cells)[at]
        if np.isnan(shares[at]):
            del cells[cell]
            continue
        free = _free(points, cells)
        miss_px = np.linalg.norm(points[free] - smooth.left_out_px[at], axis=1)
        if len(free) and miss_px.min() < off_px[at] / 2:
            cells[cell] = free[int(miss_px.argmin())]
        elif shares[at] > _OFF_SHARE:
            del cells[cell]
        else:
            return


def _fill_gaps(points: FloatArray, cells: dict[Cell, int]) -> None:
    """Find LEDs behind dark ones, where a smooth map through the others puts them."""
    found = len(cells) >= _FEWEST_FOR_CUBIC
    while found:
        found = False
        smooth = _Smooth.through(points, cells)
        places = np.array(list(cells))
        low, high = places.min(axis=0).tolist(), places.max(axis=0).tolist()
        for cell in ((i, j) for i in range(low[0], high[0] + 1) for j in range(low[1], high[1] + 1)):
            free = _free(points, cells)
            if cell in cells or not free:
                continue
            miss_px = np.linalg.norm(points[free] - smooth.to_px([cell])[0], axis=1)
            if miss_px.min() < _OFF_SHARE * smooth.step_px(cell):
                cells[cell] = free[int(miss_px.argmin())]
                found = True


def _free(points: FloatArray, cells: Mapping[Cell, int]) -> list[int]:
    """The points that no cell has."""
    return sorted(set(range(len(points))) - set(cells.values()))


def _turned_upright(points: FloatArray, cells: Mapping[Cell, int], mirrored: bool) -> dict[Cell, int]:
    """The same lattice counted along x and y."""
    places = np.array(list(cells), dtype=np.float64)
    design = np.column_stack([places, np.ones(len(places))])
    along_i, along_j, _ = np.linalg.lstsq(design, points[list(cells.values())], rcond=None)[0]
    x_in_picture = np.array([-1.0 if mirrored else 1.0, 0.0])
    y_in_picture = np.array([0.0, -1.0])
    ways = []
    for swapped in (False, True):
        for sign_x in (1, -1):
            for sign_y in (1, -1):
                x, y = (along_j, along_i) if swapped else (along_i, along_j)
                x, y = sign_x * x, sign_y * y
                if (x[0] * y[1] - x[1] * y[0] > 0) != mirrored:  # v runs down and y up
                    continue
                turn = (_angle(x_in_picture, x) + _angle(y_in_picture, y)) / 2
                spread = abs(_angle(x_in_picture, x) - _angle(y_in_picture, y))
                ways.append((abs(turn) + spread, turn, swapped, sign_x, sign_y))
    _, turn, swapped, sign_x, sign_y = min(ways)
    if abs(turn) > math.radians(LARGEST_TURN_DEG):
        raise ValueError(
            f"the plate's rows are turned by {math.degrees(turn):.0f}° in the picture; it must stand upright "
            f"to within {LARGEST_TURN_DEG:.0f}°, or its origin cannot be told"
        )
    return {
        ((sign_x * j, sign_y * i) if swapped else (sign_x * i, sign_y * j)): row
        for (i, j), row in cells.items()
    }


def _angle(wanted: FloatArray, seen: FloatArray) -> float:
    return math.atan2(
        float(wanted[0] * seen[1] - wanted[1] * seen[0]), float(wanted[0] * seen[0] + wanted[1] * seen[1])
    )


def _placed(cells: Mapping[Cell, int], columns: int, rows: int) -> npt.NDArray[np.int64]:
    """The plate's place in the lattice: the window that holds most LEDs, if no other holds nearly as many."""
    windows = _windows(cells, columns, rows)
    count, first_column, first_row = windows[0]
    upright = f"{columns} × {rows} (columns × rows)"
    if _most_in(cells, rows, columns) > count + _CLEAR_BY:
        raise ValueError(f"the lit LEDs stand {rows} × {columns} in the picture, the plate has {upright}")
    if len(windows) > 1 and count - windows[1][0] < _CLEAR_BY:
        seen = np.ptp(np.array(list(cells)), axis=0) + 1
        raise ValueError(
            f"{seen[0]} × {seen[1]} lit LEDs are seen, the plate has {upright}: where they belong in it "
            f"cannot be told, because a whole line at its edge is dark or out of the picture"
        )
    placed = np.full((rows, columns), -1, dtype=np.int64)
    for (i, j), row in cells.items():
        if first_column <= i < first_column + columns and first_row <= j < first_row + rows:
            placed[j - first_row, i - first_column] = row
    return placed
