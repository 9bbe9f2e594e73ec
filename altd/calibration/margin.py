"""How far a map is known beyond the nodes that it was made from, and how well.

Its covariance carries the nodes' noise outside the hull; that the model itself goes wrong there, it cannot
know. So each outer row of nodes is left out in turn, the others are fitted again, and the row is predicted:
what it is residuals by beyond what the covariance expects is what the model is off, one pitch outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from altd.mapping.grid import Axis
from altd.mapping.tensor_map import Fit, TensorMap
from altd.records import FloatArray

_MARGIN_PITCHES = 0.5
"""The margin in pitches: half of what was tried."""


@dataclass(frozen=True, slots=True, eq=False)
class OuterRow:
    """The nodes at one end of a grid, by their rows in the arrays, and how far off the next ones lie."""

    rows: npt.NDArray[np.intp]
    pitch_mm: float


def outer_rows(nodes_mm: FloatArray) -> list[OuterRow]:
    """The outer columns and rows of a grid (n, 2); raises ValueError when it is none."""
    outer: list[OuterRow] = []
    for along in nodes_mm.T:
        pitch_mm = Axis.through(along).step_mm
        outer += [
            OuterRow(np.flatnonzero(np.abs(along - end) < pitch_mm / 2), pitch_mm)
            for end in (along.min(), along.max())
        ]
    return outer


def with_margin(
    fit: Fit,
    nodes_mm: FloatArray,
    nodes_px: FloatArray,
    rows: Sequence[OuterRow],
    fits_without: Sequence[Fit],
) -> Fit:
    """The fit of nodes (n, 2) mm at (n, 2) px with the margin of its map.

    ``fits_without`` are those of the nodes without each of the outer ``rows``.
    """
    excess = []
    for outer, without in zip(rows, fits_without, strict=True):
        there = outer.rows
        of_row = _excess_px2(without.map, nodes_mm[there], nodes_px[there], fit.relative_sigma[there])
        excess.append(of_row / outer.pitch_mm**2)
    px_per_mm = math.sqrt(max(float(np.concatenate(excess).mean()), 0.0))
    margin_mm = _MARGIN_PITCHES * min(outer.pitch_mm for outer in rows)
    return replace(fit, map=replace(fit.map, margin_mm=margin_mm, beyond_px_per_mm=px_per_mm))


def _excess_px2(
    without: TensorMap, nodes_mm: FloatArray, nodes_px: FloatArray, relative_sigma: FloatArray
) -> FloatArray:
    """By how much the squared misses (n, 2) of nodes exceed what the map's covariance expects."""
    residuals = nodes_px - without.to_px(nodes_mm)
    expected = (without.noise_px * relative_sigma[:, None]) ** 2 + without.variance_px2(nodes_mm)
    excess: FloatArray = np.square(residuals) - expected
    return excess
