"""How a number went, as a row or a field of block characters; a gap is where it was not known."""

from __future__ import annotations

import math
from collections.abc import Sequence

from altd.terminal.canvas import Canvas, Style

_MIN_SIGMAS = 6.0
"""The full height is at least so many standard deviations, or noise would look like motion."""


def limits_of(values: Sequence[float | None], sigma: float | None) -> tuple[float, float] | None:
    """What the lowest and the highest level stand for; None: nothing is known."""
    known = [value for value in values if value is not None]
    if not known:
        return None
    low, high = min(known), max(known)
    missing = max((sigma or 0.0) * _MIN_SIGMAS - (high - low), 0.0)
    if high - low + missing == 0.0:
        missing = 1.0
    return low - missing / 2, high + missing / 2


def draw_trend(
    canvas: Canvas, row: int, column: int, rows: int, values: Sequence[float | None], sigma: float | None
) -> None:
    """A column a value, the last one at the right; with more than one row, filled from below."""
    limits = limits_of(values, sigma)
    if limits is None:
        return
    low, high = limits
    levels = canvas.levels if rows == 1 or canvas.is_utf8 else "#"
    for offset, value in enumerate(values):
        if value is None:
            continue
        height = min(math.floor((value - low) / (high - low) * rows * len(levels)), rows * len(levels) - 1)
        full, top = divmod(height, len(levels))
        for below in range(full):
            canvas.put(row + rows - 1 - below, column + offset, levels[-1], Style.PLAIN)
        canvas.put(row + rows - 1 - full, column + offset, levels[top], Style.PLAIN)
