"""Whether the frame sets of one scan node can be used."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from altd.calibration.scan_nodes import node_spot
from altd.measuring.pairing import Pair
from altd.reasons import Reason
from altd.records import Frame, NoSpot
from altd.vision.settings import SpotSettings

SpotPx = tuple[float, float]

MAX_SCATTER_PX = 1.0
"""Exposures of a stage at rest scatter by a tenth of this; further apart it still moves, or is shaken."""


@dataclass(frozen=True, slots=True)
class NodeSpots:
    """A node that can be used: the mean spot of each camera, px."""

    px: Mapping[str, SpotPx]


@dataclass(frozen=True, slots=True)
class BadNode:
    """A node that cannot: what is wrong with its first bad camera, in words."""

    complaint: str


def judge(frame_sets: Sequence[Pair[Frame]]) -> NodeSpots | BadNode:
    """Whether the frame sets of a node can be used.

    Every frame set must have one good spot on every target (``calibration.scan_nodes``), and they must agree.
    """
    means: dict[str, SpotPx] = {}
    for camera in frame_sets[0].items:
        spots = []
        for pair in frame_sets:
            spot = node_spot(pair.items[camera], SpotSettings(), None)
            if isinstance(spot, NoSpot):
                return BadNode(f"{camera} {spot.reason}" + (f" ({spot.detail})" if spot.detail else ""))
            spots.append((spot.u_px, spot.v_px))
        mean = sum(u for u, _ in spots) / len(spots), sum(v for _, v in spots) / len(spots)
        scatter_px = max(math.dist(spot, mean) for spot in spots)
        if scatter_px > MAX_SCATTER_PX:
            return BadNode(
                f"{camera} {Reason.UNSTEADY} (its exposures lie up to {scatter_px:.1f} px off their mean)"
            )
        means[camera] = mean
    return NodeSpots(means)
