"""Whether the exposures of one scan node can be used."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from altd.calibration.scan_nodes import node_spot
from altd.measuring.pairing import Pair
from altd.reasons import Reason
from altd.records import Frame, NoSpot
from altd.vision.settings import SpotSettings

SpotPx = tuple[float, float]

LARGEST_SCATTER_PX = 1.0
"""Exposures of a stage at rest scatter by a tenth of this; further apart it still moves, or is shaken."""


def judge(exposures: Sequence[Pair[Frame]]) -> Mapping[str, SpotPx] | str:
    """The mean spot of each camera, px, or what is wrong with the first bad one, in words.

    Every exposure must have one good spot on every target (``calibration.scan_nodes``), and they must agree.
    """
    means: dict[str, SpotPx] = {}
    for camera in exposures[0].items:
        spots = []
        for pair in exposures:
            spot = node_spot(pair.items[camera], SpotSettings(), None)
            if isinstance(spot, NoSpot):
                return f"{camera} {spot.reason}" + (f" ({spot.detail})" if spot.detail else "")
            spots.append((spot.u_px, spot.v_px))
        mean = sum(u for u, _ in spots) / len(spots), sum(v for _, v in spots) / len(spots)
        scatter_px = max(math.dist(spot, mean) for spot in spots)
        if scatter_px > LARGEST_SCATTER_PX:
            return f"{camera} {Reason.UNSTEADY} (its exposures lie up to {scatter_px:.1f} px off their mean)"
        means[camera] = mean
    return means
