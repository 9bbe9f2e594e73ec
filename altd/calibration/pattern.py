"""The target's own pattern in the nodes' scatter about a map, without errors that measurements do not have.

A node deviates from its map for three reasons: print and speckle shift the spot, the stage's position has an
error, and read and shot noise remain in the mean of its exposures. Only the first recurs when the unit
measures. The stage's error is common to the targets' nodes, since one beam lights them all.
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
"""Key of a node of the scan, as by ``node_key``."""

ExposureKey = tuple[Key, int, int]
"""Key of an exposure: its node, the number of its recording, its sequence number there."""

_MIN_SHARE = 0.3
"""Minimum pattern as a share of the nodes' noise; the estimate is too uncertain to reduce it further."""

_NODES_OF_SPOT = 25.0
"""Weight of the spots' shape, as a number of nodes: either predicts the ratio of the axes to 20 %."""

_MIN_SIGNIFICANCE_SIGMAS = 2.5
"""Minimum excess of common variance over chance, in sigmas, to be taken for the stage's error. At 30 nodes,
coarse patterns share by chance as much as a good stage's error; too small a sigma is worse than too large."""


@dataclass(frozen=True, slots=True, eq=False)
class NodeScatter:
    """Scatter of one target's nodes.

    ``noise_px`` is their standard deviation about the map, which has ``parameters`` for both coordinates.
    ``residuals_mm`` (2,) are measured minus mapped, ``exposures_mm`` (2,) an exposure's distance from the
    mean of its recording's exposures at the node, and ``mm_per_px`` the scale of both. ``texture_px`` is the
    pattern that the texture within the nodes' spots predicts; 0: not known.
    """

    noise_px: float
    parameters: int
    mm_per_px: float
    residuals_mm: Mapping[Key, FloatArray]
    exposures_mm: Mapping[ExposureKey, FloatArray]
    texture_px: float = 0.0

    @property
    def exposures_per_node(self) -> float:
        """Harmonic mean of the exposures per node: the variance of a node's mean falls as 1/n."""
        counts: dict[Key, int] = {}
        for node, _, _ in self.exposures_mm:
            counts[node] = counts.get(node, 0) + 1
        return 1 / float(np.mean([1 / count for count in counts.values()])) if counts else 1.0


def pattern_noise_px(targets: Sequence[NodeScatter]) -> list[float]:
    """Estimate the standard deviation of each target's pattern, px per axis."""
    pairs = list(combinations(targets, 2))
    stage_mm2 = _mean([_common_mm2(a, b) for a, b in pairs])
    vibration_mm2 = _mean([_vibration_mm2(a, b) for a, b in pairs])
    return [_pattern_px(target, stage_mm2, vibration_mm2) for target in targets]


def pattern_shape(residuals_mm: FloatArray, spot: ShapeReference | None) -> FloatArray:
    """Shape of a pattern's covariance in mm, (2, 2) of trace 2, from residuals of nodes (n, 2) and spots.

    Texture finer than a spot displaces its centre along an axis in proportion to its width there, so the
    spots predict the shape. The nodes show it directly, but 30 of them determine the ratio of both axes only
    to 20 %. Both count, the spots as much as ``_NODES_OF_SPOT`` nodes.
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
    """Pattern without the stage and each exposure's own noise; vibration, in both, is subtracted once.

    Speckle of the laser displaces both targets' spots alike, as the stage does: the texture within the spots
    shows how much of it recurs.
    """
    per_node = target.exposures_per_node
    own_mm2 = max(_vibration_mm2(target, target) - vibration_mm2, 0.0) / per_node
    other_px2 = (max(stage_mm2, vibration_mm2 / per_node) + own_mm2) / target.mm_per_px**2
    least_px = max(_MIN_SHARE * target.noise_px, min(target.texture_px, target.noise_px))
    return float(np.sqrt(max(target.noise_px**2 - other_px2, least_px**2)))


def _common_mm2(a: NodeScatter, b: NodeScatter) -> float:
    """Variance per axis that the nodes of two targets share, less the share of chance; 0 if insignificant."""
    shared = [key for key in a.residuals_mm if key in b.residuals_mm]
    if not shared:
        return 0.0
    left, right = (np.array([target.residuals_mm[key] for key in shared]) for target in (a, b))
    degrees_of_freedom = max(left.size - (a.parameters + b.parameters) / 2, 1.0)
    chance = float(np.sqrt(np.square(left).mean() * np.square(right).mean() / degrees_of_freedom))
    common = float((left * right).sum()) / degrees_of_freedom
    return common - chance if common > _MIN_SIGNIFICANCE_SIGMAS * chance else 0.0


def _vibration_mm2(a: NodeScatter, b: NodeScatter) -> float:
    """Variance per axis of single exposures that two targets share; for a target with itself, all of it."""
    shared = [key for key in a.exposures_mm if key in b.exposures_mm]
    degrees_of_freedom = 2 * (len(shared) - len({(node, recording) for node, recording, _ in shared}))
    if degrees_of_freedom <= 0:
        return 0.0
    total = sum(float(a.exposures_mm[key] @ b.exposures_mm[key]) for key in shared)
    return max(total / degrees_of_freedom, 0.0)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else 0.0
