"""Grid of known points, mm, on which a map is fitted, and the convex region inside which it is valid."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated, Self

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import Field

from altd.files.table import Millimetres
from altd.records import FloatArray

_EDGE_TOLERANCE_MM = 1e-3
_MIN_TURN = 1e-6
"""Minimum sine of the angle between two edges; below it they are one edge with a node on it."""


def convex_hull_mm(points_mm: FloatArray) -> FloatArray:
    """Return the corners (n, 2) of the convex hull of points (n, 2), counter-clockwise."""
    corners = cv2.convexHull(points_mm.astype(np.float32), clockwise=False)
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def edge_lines(hull_mm: FloatArray) -> FloatArray:
    """Return a counter-clockwise hull's edges (n, 3): a point is n_x x + n_y y − offset mm outside each."""
    edge = np.roll(hull_mm, -1, axis=0) - hull_mm
    outward = np.stack([edge[:, 1], -edge[:, 0]], axis=-1) / np.linalg.norm(edge, axis=1)[:, None]
    return np.column_stack([outward, np.einsum("ej,ej->e", outward, hull_mm)])


def moved_outwards(hull_mm: FloatArray, margin_mm: float) -> FloatArray:
    """Return the corners (n, 2) of a counter-clockwise hull with edges moved outwards by ``margin_mm``."""
    edges = edge_lines(hull_mm)
    corners = []
    for (nx, ny, offset), (before_x, before_y, before) in zip(edges, np.roll(edges, 1, axis=0), strict=True):
        turn = before_x * ny - before_y * nx
        if turn > _MIN_TURN:
            wide, wide_before = offset + margin_mm, before + margin_mm
            corners.append(
                ((ny * wide_before - before_y * wide) / turn, (before_x * wide - nx * wide_before) / turn)
            )
    return np.array(corners, dtype=np.float64).reshape(-1, 2)


def contains(hull_mm: FloatArray, points_mm: FloatArray) -> npt.NDArray[np.bool_]:
    """Return which points (n, 2) are inside a counter-clockwise hull or on its edge, to a micrometre."""
    lines = edge_lines(hull_mm)
    outside: npt.NDArray[np.float64] = points_mm @ lines[:, :2].T - lines[:, 2]
    inside: npt.NDArray[np.bool_] = outside.max(axis=1) <= _EDGE_TOLERANCE_MM
    return inside


_MIN_GAP_MM = 1e-3
_MAX_STEP_DEVIATION = 0.1
_MAX_SINGLE_STEP = 1.5
"""Maximum ratio of a step without missing nodes to the smallest step."""

MIN_LINES = 4
"""Minimum number of rows, and of columns, for a map."""

MAX_MISSING_SHARE = 0.2
"""Maximum share of nodes missing between the outermost rows and columns that are present."""

_MIN_DROPPED_SHARE = 0.5

Cell = tuple[int, int]
"""Column and row of a node, counted from any node."""


@dataclass(frozen=True, slots=True)
class Axis:
    """Equidistant positions along one axis, mm; the limits are those of a calibration file."""

    first_mm: Millimetres
    step_mm: Annotated[float, Field(gt=0, le=10_000)]
    nodes: Annotated[int, Field(ge=2, le=10_000)]

    @property
    def last_mm(self) -> float:
        """Largest position."""
        return self.first_mm + self.step_mm * (self.nodes - 1)

    @property
    def unit_per_mm(self) -> float:
        """Derivative d(unit)/d(mm) of ``to_unit``."""
        return 2 / (self.nodes * self.step_mm)

    def to_unit(self, mm: FloatArray) -> FloatArray:
        """Return positions in the units of the Gram basis (Eq. 3.22)."""
        return (mm - self.first_mm) * self.unit_per_mm - 1 + 1 / self.nodes

    @classmethod
    def through(cls, mm: FloatArray) -> Self:
        """Return the axis through positions near equidistant nodes, as a stage reports them.

        Positions closer together than a third of the widest gap count as one node; the nodes' means may be
        off equal steps by a tenth of a step, since the fit uses the positions themselves. Nodes may be
        missing in between. Raises ValueError if there are fewer than two nodes or the steps differ by more.
        """
        ordered = np.sort(mm)
        gaps = np.diff(ordered)
        if not len(gaps) or gaps.max() <= _MIN_GAP_MM:
            raise ValueError("all nodes have the same position; are the positions in mm?")
        nodes = np.array(
            [part.mean() for part in np.split(ordered, np.flatnonzero(gaps > gaps.max() / 3) + 1)]
        )
        steps = np.diff(nodes)
        single = steps[steps < _MAX_SINGLE_STEP * steps.min()]
        numbers = np.rint((nodes - nodes[0]) / single.mean())
        step = float((nodes[-1] - nodes[0]) / numbers[-1])
        off = nodes - (nodes[0] + step * numbers)
        if np.abs(off).max() > _MAX_STEP_DEVIATION * step:
            raise ValueError(f"steps from {steps.min():.3f} to {steps.max():.3f} mm are not equal")
        return cls(float(nodes[0]), step, int(numbers[-1]) + 1)

    def numbers(self, mm: FloatArray) -> npt.NDArray[np.intp]:
        """Return which node of the axis each position belongs to, counted from 0 at the first."""
        return np.rint((mm - self.first_mm) / self.step_mm).astype(np.intp)


@dataclass(frozen=True, slots=True)
class GridPart:
    """Part of a grid within the rows and columns that remain when incomplete outer ones are dropped."""

    columns: range
    rows: range
    missing: int
    """Number of nodes within it that are missing."""

    @property
    def cells(self) -> int:
        """Number of nodes within it."""
        return len(self.columns) * len(self.rows)

    @property
    def most_missing(self) -> int:
        """Maximum number of its nodes that may be missing."""
        return int(MAX_MISSING_SHARE * self.cells)

    @property
    def is_sufficient(self) -> bool:
        """Whether it is sufficient for a map."""
        return min(len(self.columns), len(self.rows)) >= MIN_LINES and self.missing <= self.most_missing

    @classmethod
    def within(cls, cells: Collection[Cell], missing: Collection[Cell]) -> Self:
        """Return the block of a grid of ``cells`` of which some are ``missing``.

        While too many are missing, the outer row or column that misses most is dropped, if over half.
        """
        gone = set(missing)
        columns, rows = (range(min(line), max(line) + 1) for line in zip(*cells, strict=True))
        while True:
            inside = [(column, row) for column, row in gone if column in columns and row in rows]
            block = cls(columns, rows, len(inside))
            if len(inside) <= block.most_missing:
                return block
            without = [
                (sum(column == end for column, _ in inside) / len(rows), "column", end)
                for end in (columns[0], columns[-1])
            ]
            without += [
                (sum(row == end for _, row in inside) / len(columns), "row", end)
                for end in (rows[0], rows[-1])
            ]
            share, line, end = max(without)
            if share <= _MIN_DROPPED_SHARE:
                return block
            if line == "column":
                columns = _without(columns, end)
            else:
                rows = _without(rows, end)


def _without(line: range, end: int) -> range:
    """Return a range without its first or its last number."""
    return line[1:] if end == line[0] else line[:-1]
