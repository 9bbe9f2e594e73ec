"""Derivatives of a map that has no formula for them, by central differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from altd.records import FloatArray

ToPx = Callable[[FloatArray], FloatArray]
"""Points (n, 2) mm to (n, 2) px."""


def jacobian_px_per_mm(to_px: ToPx, points_mm: FloatArray, step_mm: float) -> FloatArray:
    """d(u, v)/d(x, y) of a map at points (n, 2), as (n, 2, 2), from places ``step_mm`` to either side."""
    along = [
        (to_px(points_mm + step) - to_px(points_mm - step)) / (2 * step_mm) for step in step_mm * np.eye(2)
    ]
    return np.stack(along, axis=-1)
