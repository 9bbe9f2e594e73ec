"""Assignment of found LEDs to positions in the plate's grid, from neighbour to neighbour.

A full grid looks the same upside down, and mirrored except for the side of its columns. So two things are
taken as known: whether the camera sees the target mirrored, and that up in the image is up (+y), to within
``MAX_TURN_DEG``.
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

MAX_TURN_DEG = 30.0

Cell = tuple[int, int]

_MAX_STARTS = 9
_MAX_NEIGHBOURS = 6
_MAX_STEP_DEVIATION = 0.3
"""Maximum deviation of a neighbour from the position by the previous step, as a share of the step."""
_MAX_CUBIC_DEVIATION = 0.2
"""The same for the position that a cubic map through all the others predicts."""
_MIN_FOR_CUBIC = 16
_MIN_REDUNDANCY = 0.08
"""Minimum of 1 − leverage: a point with less determines the cubic alone, and no other can check it."""
_MIN_LATTICE_SHARE = 0.5
_MIN_MARGIN_LEDS = 2
"""Number of LEDs by which the grid must fit better than when shifted by a line."""


@dataclass(frozen=True, slots=True, eq=False)
class GridMatch:
    """``rows_of`` (rows, columns) holds the row of the point that is the LED there, −1 if there is none.

    Counted from the LED with the smallest x and the smallest y. ``extra`` are points that are no LED.
    """

    rows_of: npt.NDArray[np.int64]
    extra: tuple[int, ...]


def match_grid(points_px: FloatArray, columns: int, rows: int, mirrored: bool) -> GridMatch:
    """Match points (n, 2) px to a grid of columns × rows; points may be missing or false.

    Raises ValueError, with a message for the user, if they are no such grid or their place in it is unknown.
    """
    cells = _largest_lattice(points_px, columns, rows)
    if len(cells) < max(_MIN_LATTICE_SHARE * columns * rows, 6):
        raise ValueError(f"of {len(points_px)} lights only {len(cells)} lie on a grid")
    _remove_outliers(points_px, cells)
    _fill_gaps(points_px, cells)
    _remove_outliers(points_px, cells)
    upright = _oriented(points_px, cells, mirrored)
    placed = _placed_in_grid(upright, columns, rows)
    extra = sorted(set(range(len(points_px))) - set(placed[placed >= 0].tolist()))
    return GridMatch(placed, tuple(extra))


def _largest_lattice(points: FloatArray, columns: int, rows: int) -> dict[Cell, int]:
    """Return the lattice with most points within a window of the grid's size, in either orientation."""
    best: dict[Cell, int] = {}
    best_count = 0
    if len(points) < 4:
        return best
    middle = np.median(points, axis=0)
    for start in np.argsort(np.linalg.norm(points - middle, axis=1))[:_MAX_STARTS].tolist():
        offsets = points - points[start]
        near = np.argsort(np.linalg.norm(offsets, axis=1))[1 : _MAX_NEIGHBOURS + 1].tolist()
        for at, first in enumerate(near):
            for second in near[at + 1 :]:
                a, b = offsets[first], offsets[second]
                sine = abs(a[0] * b[1] - a[1] * b[0]) / (np.linalg.norm(a) * np.linalg.norm(b))
                if sine < 0.6:
                    continue
                cells = _follow_lattice(points, start, a, b)
                count = max(_max_count(cells, columns, rows), _max_count(cells, rows, columns))
                if count > best_count:
                    best, best_count = cells, count
                if count == min(columns * rows, len(points)):
                    return best
    return best


def _follow_lattice(points: FloatArray, start: int, a: FloatArray, b: FloatArray) -> dict[Cell, int]:
    """Return the lattice of steps from neighbour to neighbour; each is that of the nearest known pair."""
    cells: dict[Cell, int] = {(0, 0): start}
    free = np.ones(len(points), dtype=bool)
    free[start] = False
    queue = deque([(0, 0)])
    while queue:
        at = queue.popleft()
        for direction, first in (((1, 0), a), ((-1, 0), -a), ((0, 1), b), ((0, -1), -b)):
            to = at[0] + direction[0], at[1] + direction[1]
            if to in cells:
                continue
            step = _step(points, cells, at, direction)
            step = first if step is None else step
            distance_px = np.linalg.norm(points - (points[cells[at]] + step), axis=1)
            distance_px[~free] = np.inf
            nearest = int(distance_px.argmin())
            if distance_px[nearest] < _MAX_STEP_DEVIATION * np.linalg.norm(step):
                cells[to] = nearest
                free[nearest] = False
                queue.append(to)
    return cells


def _step(points: FloatArray, cells: Mapping[Cell, int], at: Cell, direction: Cell) -> FloatArray | None:
    """Return a cell's step predicted by its neighbours: the previous one, else those beside it."""
    i, j = at
    di, dj = direction
    before = cells.get((i - di, j - dj))
    if before is not None:
        return np.asarray(points[cells[at]] - points[before])
    beside = [(i + dj, j + di), (i - dj, j - di)]
    pairs = [(cells.get(cell), cells.get((cell[0] + di, cell[1] + dj))) for cell in beside]
    steps = [points[end] - points[start] for start, end in pairs if start is not None and end is not None]
    return np.asarray(np.mean(steps, axis=0)) if steps else None


def _max_count(cells: Mapping[Cell, int], columns: int, rows: int) -> int:
    """Return the largest number of cells in a window of columns × rows."""
    return max(count for count, _, _ in _windows(cells, columns, rows))


def _windows(cells: Mapping[Cell, int], columns: int, rows: int) -> list[tuple[int, int, int]]:
    """Return the number of cells in each window (first column, first row) of that size, most first."""
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
class _CubicMap:
    """Cubic map through the lattice's points: cell → px."""

    centre: FloatArray
    scale: float
    coefficients: FloatArray
    leave_one_out_px: FloatArray
    """Each lattice point's position predicted by the fit to all others, (n, 2); NaN without redundancy."""

    @classmethod
    def fit(cls, points: FloatArray, cells: Mapping[Cell, int]) -> Self:
        """Fit by least squares, with the leave-one-out prediction of each point by its leverage."""
        places = np.array(list(cells), dtype=np.float64)
        seen = points[list(cells.values())]
        centre, scale = places.mean(axis=0), float(np.ptp(places, axis=0).max() / 2)
        design = _cubic((places - centre) / scale)
        inverse = np.linalg.pinv(design)
        coefficients = inverse @ seen
        redundancy = 1 - np.einsum("nk,kn->n", design, inverse)[:, None]
        redundancy = np.where(redundancy < _MIN_REDUNDANCY, np.nan, redundancy)
        return cls(centre, scale, coefficients, seen - (seen - design @ coefficients) / redundancy)

    def to_px(self, cells: npt.ArrayLike) -> FloatArray:
        """Return the positions (n, 2) of cells (n, 2)."""
        places = np.asarray(cells, dtype=np.float64)
        return np.asarray(_cubic((places - self.centre) / self.scale) @ self.coefficients)

    def step_px(self, cell: Cell) -> float:
        """Return the shorter step from a cell to the next ones."""
        here, right, up = self.to_px([cell, (cell[0] + 1, cell[1]), (cell[0], cell[1] + 1)])
        return float(min(np.linalg.norm(right - here), np.linalg.norm(up - here)))


def _cubic(q: FloatArray) -> FloatArray:
    """Return all monomials up to total degree 3 of points (n, 2)."""
    return np.stack([q[:, 0] ** i * q[:, 1] ** j for i in range(4) for j in range(4 - i)], axis=-1)


def _remove_outliers(points: FloatArray, cells: dict[Cell, int]) -> None:
    """Replace or remove the point with the largest leave-one-out residual until none is an outlier.

    The steps may have reached a light beside an LED, or in the place of a dark one.
    """
    for _ in range(2 * len(points)):
        if len(cells) < _MIN_FOR_CUBIC:
            return
        cubic = _CubicMap.fit(points, cells)
        residuals_px = np.linalg.norm(points[list(cells.values())] - cubic.leave_one_out_px, axis=1)
        shares = residuals_px / np.array([cubic.step_px(cell) for cell in cells])
        at = int(np.where(np.isnan(shares), np.inf, shares).argmax())
        cell = list(cells)[at]
        if np.isnan(shares[at]):
            del cells[cell]
            continue
        free = _free(points, cells)
        distance_px = np.linalg.norm(points[free] - cubic.leave_one_out_px[at], axis=1)
        if len(free) and distance_px.min() < residuals_px[at] / 2:
            cells[cell] = free[int(distance_px.argmin())]
        elif shares[at] > _MAX_CUBIC_DEVIATION:
            del cells[cell]
        else:
            return


def _fill_gaps(points: FloatArray, cells: dict[Cell, int]) -> None:
    """Assign LEDs behind dark ones, where the cubic map through the others predicts them."""
    found = len(cells) >= _MIN_FOR_CUBIC
    while found:
        found = False
        cubic = _CubicMap.fit(points, cells)
        places = np.array(list(cells))
        low, high = places.min(axis=0).tolist(), places.max(axis=0).tolist()
        for cell in ((i, j) for i in range(low[0], high[0] + 1) for j in range(low[1], high[1] + 1)):
            free = _free(points, cells)
            if cell in cells or not free:
                continue
            distance_px = np.linalg.norm(points[free] - cubic.to_px([cell])[0], axis=1)
            if distance_px.min() < _MAX_CUBIC_DEVIATION * cubic.step_px(cell):
                cells[cell] = free[int(distance_px.argmin())]
                found = True


def _free(points: FloatArray, cells: Mapping[Cell, int]) -> list[int]:
    """Return the points that no cell has."""
    return sorted(set(range(len(points))) - set(cells.values()))


def _oriented(points: FloatArray, cells: Mapping[Cell, int], mirrored: bool) -> dict[Cell, int]:
    """Return the lattice with its cells counted along x and y."""
    places = np.array(list(cells), dtype=np.float64)
    design = np.column_stack([places, np.ones(len(places))])
    along_i, along_j, _ = np.linalg.lstsq(design, points[list(cells.values())], rcond=None)[0]
    x_in_picture = np.array([-1.0 if mirrored else 1.0, 0.0])
    y_in_picture = np.array([0.0, -1.0])
    orientations = []
    for swapped in (False, True):
        for sign_x in (1, -1):
            for sign_y in (1, -1):
                x, y = (along_j, along_i) if swapped else (along_i, along_j)
                x, y = sign_x * x, sign_y * y
                if (x[0] * y[1] - x[1] * y[0] > 0) != mirrored:  # v runs down and y up
                    continue
                turn = (_angle(x_in_picture, x) + _angle(y_in_picture, y)) / 2
                skew = abs(_angle(x_in_picture, x) - _angle(y_in_picture, y))
                orientations.append((abs(turn) + skew, turn, swapped, sign_x, sign_y))
    _, turn, swapped, sign_x, sign_y = min(orientations)
    if abs(turn) > math.radians(MAX_TURN_DEG):
        raise ValueError(
            f"the plate's rows are turned by {math.degrees(turn):.0f}° in the picture; it must be upright "
            f"to within {MAX_TURN_DEG:.0f}°, or its origin cannot be found"
        )
    return {
        ((sign_x * j, sign_y * i) if swapped else (sign_x * i, sign_y * j)): row
        for (i, j), row in cells.items()
    }


def _angle(wanted: FloatArray, seen: FloatArray) -> float:
    return math.atan2(
        float(wanted[0] * seen[1] - wanted[1] * seen[0]), float(wanted[0] * seen[0] + wanted[1] * seen[1])
    )


def _placed_in_grid(cells: Mapping[Cell, int], columns: int, rows: int) -> npt.NDArray[np.int64]:
    """Place the grid on the window with most LEDs; raises ValueError if another one has nearly as many."""
    windows = _windows(cells, columns, rows)
    count, first_column, first_row = windows[0]
    upright = f"{columns} × {rows} (columns × rows)"
    if _max_count(cells, rows, columns) > count + _MIN_MARGIN_LEDS:
        raise ValueError(f"the lit LEDs form {rows} × {columns} in the picture, the plate has {upright}")
    if len(windows) > 1 and count - windows[1][0] < _MIN_MARGIN_LEDS:
        seen = np.ptp(np.array(list(cells)), axis=0) + 1
        raise ValueError(
            f"{seen[0]} × {seen[1]} lit LEDs are seen, the plate has {upright}: where they belong in it "
            f"is unknown, because a whole line at its edge is dark or out of the picture"
        )
    placed = np.full((rows, columns), -1, dtype=np.int64)
    for (i, j), row in cells.items():
        if first_column <= i < first_column + columns and first_row <= j < first_row + rows:
            placed[j - first_row, i - first_column] = row
    return placed
