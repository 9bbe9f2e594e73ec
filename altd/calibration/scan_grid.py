"""Whether the nodes of a scan make a sufficient grid, how much each one counts, and whether scans agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.calibration.scan_nodes import Job, Node, ScannedTarget
from altd.mapping.grid import Axis, Block, convex_hull_mm
from altd.mapping.inverse import InverseMap
from altd.mapping.lens import fit_lens_map
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import TensorMap, fit_tensor_map
from altd.records import FloatArray

_MAX_SIGMA_RATIO = 1.5
"""Up to so many times the median sigma spots are alike: print and speckle move a dim one no more."""
_ITERATIONS = 3


@dataclass(frozen=True, slots=True)
class ScanGrid:
    """The grid of a scan: its axes, the block that can be used, and the rows and columns that cannot."""

    axes: tuple[Axis, Axis]
    block: Block
    usable_mm: FloatArray

    def missing_ends(self, margin_mm: float) -> list[str]:
        """In words: each end of the grid at which no node can be used, and where what is measured ends."""
        words = []
        for axis, along, name in zip(self.axes, self.usable_mm.T, "xy", strict=True):
            for end, last, outward in (
                (axis.first_mm, float(along.min()), -1),
                (axis.last_mm, float(along.max()), 1),
            ):
                if abs(end - last) > axis.step_mm / 2:
                    line = "column" if name == "x" else "row"
                    words.append(
                        f"no node of the outer {line} at {name} {end:g} mm can be used: what can be "
                        f"measured ends at {name} {last + outward * margin_mm:.1f} mm"
                    )
        return words


def scan_grid(scanned: ScannedTarget) -> ScanGrid:
    """The grid of the nodes of one target; raises ValueError when they are none."""
    nodes = list(scanned.nodes.values())
    positions_mm = np.array([node.position_mm for node in nodes])
    axes = Axis.through(positions_mm[:, 0]), Axis.through(positions_mm[:, 1])
    numbers = [axis.numbers(along).tolist() for axis, along in zip(axes, positions_mm.T, strict=True)]
    cells = list(zip(*numbers, strict=True))
    missing = [cell for cell, node in zip(cells, nodes, strict=True) if not node.is_usable]
    usable = np.array([node.is_usable for node in nodes])
    return ScanGrid(axes, Block.within(cells, missing), positions_mm[usable])


def relative_sigmas(nodes: Sequence[Node], image_size: tuple[int, int]) -> FloatArray:
    """By how much each node (n,) scatters more than an ordinary one, by what its spots are known to.

    An ordinary node scatters by what print and speckle do to its spot, which is seen about a first map; one
    that the border of the picture cuts by more, which its own sigmas say. Raises ValueError when the nodes
    are too few for a map.
    """
    sigmas_px = np.array([node.sigma_px for node in nodes])
    relative = np.ones(len(nodes))
    uneven = sigmas_px > _MAX_SIGMA_RATIO * np.median(sigmas_px)
    if not uneven.any():
        return relative
    places_mm = np.array([node.position_mm for node in nodes])
    places_px = np.array([node.spot_px for node in nodes])
    hull_mm = convex_hull_mm(places_mm)
    for _ in range(_ITERATIONS):
        first = (
            fit_tensor_map(places_mm, places_px, hull_mm, None, relative),
            fit_lens_map(Nodes(places_mm, places_px, relative), hull_mm, image_size),
        )
        ordinary_px = min(fit.map.noise_px for fit in first)
        relative = np.where(uneven, np.maximum(sigmas_px / ordinary_px, 1.0), 1.0)
    return relative


def offset_doubts(job: Job, nodes: Sequence[Node], fitted: TensorMap) -> tuple[str, ...]:
    """Which scans of a target lie off its first one by more than its nodes scatter, in words.

    A stage's zero, a camera or a target may have moved between them.

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
