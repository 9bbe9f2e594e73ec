"""The grid of known points, mm, on which a map is fitted, and the convex region inside which it is valid."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import FloatArray

_EDGE_TOLERANCE_MM = 1e-3
_MIN_TURN = 1e-6
"""Sine of the angle between two edges; below it they are one edge with a node on it."""


def convex_hull_mm(points_mm: FloatArray) -> FloatArray:
    """Corners (n, 2) of the convex hull of points (n, 2), counter-clockwise."""
    corners = cv2.convexHull(points_mm.astype(np.float32), clockwise=False)
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def edge_lines(hull_mm: FloatArray) -> FloatArray:
    """The edges of a counter-clockwise hull as (n, 3): a point lies outside by n_x x + n_y y − offset, mm."""
    edge = np.roll(hull_mm, -1, axis=0) - hull_mm
    outward = np.stack([edge[:, 1], -edge[:, 0]], axis=-1) / np.linalg.norm(edge, axis=1)[:, None]
    return np.column_stack([outward, np.einsum("ej,ej->e", outward, hull_mm)])


def moved_outwards(hull_mm: FloatArray, margin_mm: float) -> FloatArray:
    """Corners (n, 2) of a counter-clockwise hull whose edges are moved outwards by ``margin_mm``."""
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
    """Which of the points (n, 2) lie inside a counter-clockwise hull or on its edge, to a micrometre."""
    lines = edge_lines(hull_mm)
    outside: npt.NDArray[np.float64] = points_mm @ lines[:, :2].T - lines[:, 2]
    inside: npt.NDArray[np.bool_] = outside.max(axis=1) <= _EDGE_TOLERANCE_MM
    return inside


_MIN_GAP_MM = 1e-3
_MAX_STEP_DEVIATION = 0.1
_MAX_SINGLE_STEP = 1.5
"""Steps up to so many times the smallest one have no node between them that is missing."""

MIN_LINES = 4
"""The rows, and the columns, that a map needs."""

MAX_MISSING_SHARE = 0.2
"""Of the nodes between the outermost rows and columns that are there."""

_MIN_DROPPED_SHARE = 0.5

Cell = tuple[int, int]
"""Column and row of a node, counted from any one."""


@dataclass(frozen=True, slots=True)
class Axis:
    """Equidistant positions along one axis, mm."""

    first_mm: float
    step_mm: float
    nodes: int

    @property
    def last_mm(self) -> float:
        """The largest position."""
        return self.first_mm + self.step_mm * (self.nodes - 1)

    @property
    def unit_per_mm(self) -> float:
        """d(unit)/d(mm) of ``to_unit``."""
        return 2 / (self.nodes * self.step_mm)

    def to_unit(self, mm: FloatArray) -> FloatArray:
        """Positions in the units of the Gram basis (Eq. 3.22)."""
        return (mm - self.first_mm) * self.unit_per_mm - 1 + 1 / self.nodes

    @classmethod
    def through(cls, mm: FloatArray) -> Self:
        """The axis through positions that lie near equidistant nodes, as a stage reports them.

        Positions closer together than a third of the widest gap count as one node; the nodes' means may
        lie off equal steps by a tenth of a step, since the fit uses the positions themselves. A node may be
        missing in between. Raises ValueError when there are fewer than two nodes or the steps differ by more.
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
        """Which node of the axis each position belongs to, counted from 0 at the first."""
        return np.rint((mm - self.first_mm) / self.step_mm).astype(np.intp)


@dataclass(frozen=True, slots=True)
class Block:
    """The rest of a grid without the outer rows and columns that are missing."""

    columns: range
    rows: range
    missing: int
    """Nodes within it that are missing."""

    @property
    def cells(self) -> int:
        """Nodes within it."""
        return len(self.columns) * len(self.rows)

    @property
    def most_missing(self) -> int:
        """The number of its nodes that may be missing."""
        return int(MAX_MISSING_SHARE * self.cells)

    @property
    def is_sufficient(self) -> bool:
        """Whether a map can be made of it."""
        return min(len(self.columns), len(self.rows)) >= MIN_LINES and self.missing <= self.most_missing

    @classmethod
    def within(cls, cells: Collection[Cell], missing: Collection[Cell]) -> Self:
        """The block of a grid of ``cells`` of which some are ``missing``.

        While too many are missing, the outer row or column that misses most goes, if that is most of it.
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
    """A range without its first or its last number."""
    return line[1:] if end == line[0] else line[:-1]
