"""The convex region in which a map was measured; nothing is extrapolated beyond it."""

from __future__ import annotations

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
