"""The target's own pattern in the nodes' scatter about a map, and the part that a measurement will not see.

A node lies off its map for three reasons: print and speckle shift the spot, the beam was not where the stage
said, and read and shot noise are left in the mean of its exposures. Only the first is there again when the
unit measures. The stage's error is what the targets' nodes have in common, since one beam lights them all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from altd.records import FloatArray
from altd.vision.settings import ShapeReference

Key = tuple[int, int]
"""A node of the scan."""

ExposureKey = tuple[Key, int, int]
"""An exposure: its node, the number of its recording, its sequence there."""

_MIN_SHARE = 0.3
"""A part below this share is not known well enough to be reduced further."""

_NODES_OF_SPOT = 25.0
"""The spots' shape predicts the ratio of the axes to 20 %, as so many nodes do."""

_MIN_SIGNIFICANCE_SIGMAS = 2.5
"""Coarse patterns at 30 nodes share by chance as much as a good stage's error. Only what is that far beyond
chance is taken for the stage's: a sigma that is too small is worse than one that is too large."""


@dataclass(frozen=True, slots=True, eq=False)
class NodeScatter:
    """One target's nodes.

    ``noise_px`` is their standard deviation about the map, which has ``parameters`` for both coordinates.
    ``residuals_mm`` (2,) are measured minus mapped, ``exposures_mm`` (2,) an exposure's distance from the
    mean of its recording's exposures at the node, and ``mm_per_px`` the scale of both.
    """

    noise_px: float
    parameters: int
    mm_per_px: float
    residuals_mm: Mapping[Key, FloatArray]
    exposures_mm: Mapping[ExposureKey, FloatArray]

    @property
    def exposures_per_node(self) -> float:
        """Their harmonic mean: a node's mean scatters by 1/n."""
        counts: dict[Key, int] = {}
        for node, _, _ in self.exposures_mm:
            counts[node] = counts.get(node, 0) + 1
        return 1 / float(np.mean([1 / count for count in counts.values()])) if counts else 1.0


def pattern_noise_px(targets: Sequence[NodeScatter]) -> list[float]:
    """The standard deviation of each target's pattern, px per axis."""
    pairs = list(combinations(targets, 2))
    stage_mm2 = _mean([_common_mm2(a, b) for a, b in pairs])
    vibration_mm2 = _mean([_vibration_mm2(a, b) for a, b in pairs])
    return [_pattern_px(target, stage_mm2, vibration_mm2) for target in targets]


def pattern_shape(residuals_mm: FloatArray, spot: ShapeReference | None) -> FloatArray:
    """The shape of a pattern's covariance in mm, (2, 2) of trace 2, from nodes (n, 2) and their spots.

    Texture finer than a spot displaces its centre along an axis in proportion to its width there. That is
    what the spots say; the nodes say it themselves, but 30 of them know the ratio of both axes to 20 %. Both
    count, the spots as much as ``_NODES_OF_SPOT``.
    """
    expected = np.eye(2)
    if spot is not None:
        _, along, across, _ = spot.mean
        stretch = max(math.hypot(along, across), 1e-9)
        expected += math.tanh(2 * stretch) / stretch * np.array([[along, across], [across, -along]])
    seen = residuals_mm.T @ residuals_mm
    if not np.trace(seen) > 0:
        return expected
    shape: FloatArray = _NODES_OF_SPOT * expected + len(residuals_mm) * 2 / np.trace(seen) * seen
    shape *= 2 / np.trace(shape)
    return shape


def _pattern_px(target: NodeScatter, stage_mm2: float, vibration_mm2: float) -> float:
    """Without the stage, and without each exposure's own noise; vibration is in both, subtracted once."""
    per_node = target.exposures_per_node
    own_mm2 = max(_vibration_mm2(target, target) - vibration_mm2, 0.0) / per_node
    other_px2 = (max(stage_mm2, vibration_mm2 / per_node) + own_mm2) / target.mm_per_px**2
    return float(np.sqrt(max(target.noise_px**2 - other_px2, (_MIN_SHARE * target.noise_px) ** 2)))


def _common_mm2(a: NodeScatter, b: NodeScatter) -> float:
    """Variance per axis that the nodes of two targets share, less what chance may make; 0 when unsure."""
    shared = [key for key in a.residuals_mm if key in b.residuals_mm]
    if not shared:
        return 0.0
    left, right = (np.array([target.residuals_mm[key] for key in shared]) for target in (a, b))
    degrees_of_freedom = max(left.size - (a.parameters + b.parameters) / 2, 1.0)
    chance = float(np.sqrt(np.square(left).mean() * np.square(right).mean() / degrees_of_freedom))
    common = float((left * right).sum()) / degrees_of_freedom
    return common - chance if common > _MIN_SIGNIFICANCE_SIGMAS * chance else 0.0


def _vibration_mm2(a: NodeScatter, b: NodeScatter) -> float:
    """Variance per axis of single exposures that two targets share; of a target with itself, all of it."""
    shared = [key for key in a.exposures_mm if key in b.exposures_mm]
    degrees_of_freedom = 2 * (len(shared) - len({(node, recording) for node, recording, _ in shared}))
    if degrees_of_freedom <= 0:
        return 0.0
    total = sum(float(a.exposures_mm[key] @ b.exposures_mm[key]) for key in shared)
    return max(total / degrees_of_freedom, 0.0)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else 0.0
