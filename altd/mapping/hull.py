"""The convex region in which a map was measured; nothing is extrapolated beyond it."""

from __future__ import annotations

import cv2
import numpy as np

from altd.records import FloatArray


def convex_hull_mm(points_mm: FloatArray) -> FloatArray:
    """Corners (n, 2) of the convex hull of points (n, 2), counter-clockwise."""
    corners = cv2.convexHull(points_mm.astype(np.float32), clockwise=False)
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def distance_outside_mm(points_mm: FloatArray, hull_mm: FloatArray) -> FloatArray:
    """How far points (n, 2) lie beyond the edge lines of a counter-clockwise hull; negative inside."""
    start = hull_mm
    edge = np.roll(hull_mm, -1, axis=0) - start
    outward = np.stack([edge[:, 1], -edge[:, 0]], axis=-1) / np.linalg.norm(edge, axis=1)[:, None]
    distances = np.einsum("nej,ej->ne", points_mm[:, None, :] - start[None], outward)
    return np.asarray(distances.max(axis=1))
