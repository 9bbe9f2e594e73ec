"""Whether several scans of one target show the same: a stage's zero, a camera or a target may have moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from altd.calibration.scan_nodes import Job, Node
from altd.mapping.inverse import InverseMap
from altd.mapping.tensor_map import TensorMap


def offset_doubts(job: Job, nodes: Sequence[Node], fitted: TensorMap) -> tuple[str, ...]:
    """Which scans of a target lie off its first one by more than its nodes scatter, in words.

    By the mean over the nodes that both have: print and speckle are the same in both, and what single
    exposures scatter averages out.
    """
    first, *others = job.frames.parts
    doubts = []
    for other in others:
        shared = [
            (visits[first.number], visits[other.number], node)
            for node in nodes
            if {first.number, other.number} <= (visits := node.good_visits).keys()
        ]
        if not shared:
            continue
        offset_px = np.mean([there.spot_px - here.spot_px for here, there, _ in shared], axis=0)
        if float(np.linalg.norm(offset_px)) <= fitted.noise_px:
            continue
        middle_px = fitted.to_px(np.array([node.position_mm for _, _, node in shared])).mean(axis=0)
        jacobian = InverseMap.of(fitted).to_mm(middle_px[None])[1][0]
        offset_mm = float(np.linalg.norm(jacobian @ offset_px))
        doubts.append(
            f"{job.name}: {other.recording.path} puts the spots of {len(shared)} nodes {offset_mm:.2f} mm "
            f"from where {first.recording.path} does: what was moved between the scans?"
        )
    return tuple(doubts)
