"""The plan of a calibration scan, node by node, and whether the frame sets of a node can be used."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from altd.calibration.scan_nodes import node_spot
from altd.config import Config, Scan
from altd.errors import BadInputError
from altd.measuring.pairing import Pair
from altd.reasons import Reason
from altd.records import Frame, NoSpot
from altd.vision.settings import SpotSettings

SpotPx = tuple[float, float]

MAX_SCATTER_PX = 1.0
"""Maximum distance of a spot from the mean of its node. Exposures at rest scatter by a tenth of this; with
more, the stage still moves or vibrates."""


_SAME_MM = 1e-6


@dataclass(frozen=True, slots=True)
class NodeSpots:
    """A usable node: the mean spot of each camera, px."""

    px: Mapping[str, SpotPx]


@dataclass(frozen=True, slots=True)
class BadNode:
    """An unusable node: the fault of its first bad camera, as text."""

    complaint: str


def judge(frame_sets: Sequence[Pair[Frame]]) -> NodeSpots | BadNode:
    """Judge whether the frame sets of a node can be used.

    Every frame must have one good spot (``calibration.scan_nodes``), and the spots of a camera must agree.
    """
    means: dict[str, SpotPx] = {}
    for camera in {camera: None for pair in frame_sets for camera in pair.items}:
        spots = []
        for frame in [pair.items[camera] for pair in frame_sets if camera in pair.items]:
            spot = node_spot(frame, SpotSettings(), None)
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


@dataclass(frozen=True, slots=True)
class Node:
    """One point of the grid, mm in the unit frame."""

    column: int
    row: int
    x_mm: float
    y_mm: float

    def __str__(self) -> str:
        return f"x {self.x_mm:g} y {self.y_mm:g} mm"


def nodes_of(scan: Scan) -> tuple[Node, ...]:
    """Return the nodes of the grid in the order in which the stage visits them."""
    nodes = []
    for row in range(scan.rows):
        back = scan.order == "serpentine" and row % 2 == 1
        columns = range(scan.columns)
        for column in reversed(columns) if back else columns:
            x_mm = scan.centre_x_mm + (column - (scan.columns - 1) / 2) * scan.pitch_mm
            y_mm = scan.centre_y_mm + (row - (scan.rows - 1) / 2) * scan.pitch_mm
            nodes.append(Node(column, row, x_mm, y_mm))
    return tuple(nodes)


class Raster(Scan):
    """Scan of a flat made with the laser: over a grid and a margin, in steps smaller than the spot."""

    columns: int
    rows: int
    kind: Literal["flat"] = "flat"
    grid: Scan

    @classmethod
    def over(cls, grid: Scan) -> Raster:
        """Return the raster over a grid and ``flat_margin_mm`` beyond it: one exposure per node, no LEDs.

        Raises BadInputError for a turned unit: its positions are in another frame.
        """
        if grid.turned_deg:
            raise BadInputError("[scan] turned_deg", "a flat is recorded with the unit as it is: set 0")
        steps = (
            math.ceil(((lines - 1) * grid.pitch_mm + 2 * grid.flat_margin_mm) / grid.flat_pitch_mm - _SAME_MM)
            for lines in (grid.columns, grid.rows)
        )
        columns, rows = (count + 1 for count in steps)
        same = grid.model_dump(include={"centre_x_mm", "centre_y_mm", "order", "settle_s", "retries"})
        pitch_mm = grid.flat_pitch_mm
        return cls(columns=columns, rows=rows, pitch_mm=pitch_mm, exposures=1, led_pairs=0, grid=grid, **same)

    def is_margin(self, node: Node) -> bool:
        """Whether a node is outside the grid, where its spot may be incomplete."""
        grid = self.grid
        half_x_mm, half_y_mm = ((lines - 1) / 2 * grid.pitch_mm for lines in (grid.columns, grid.rows))
        x_mm, y_mm = abs(node.x_mm - grid.centre_x_mm), abs(node.y_mm - grid.centre_y_mm)
        return x_mm > half_x_mm + _SAME_MM or y_mm > half_y_mm + _SAME_MM


Facts = dict[str, str | int | float]
"""Settings by their config keys."""


def fingerprint(config: Config) -> Facts:
    """Return the settings that must be equal in all parts of one scan.

    The stage's connection, its speed, and the scan's times and retries may change in between. The positions
    of the nodes and the stage's coordinates may not.
    """
    facts: Facts = {"unit.serial": config.unit.serial}
    for target in config.targets:
        facts[f"targets.{target.name}.z_mm"] = target.z_mm
        if target.glass is not None:
            facts[f"targets.{target.name}.glass_mm"] = target.glass.thickness_mm
            facts[f"targets.{target.name}.glass_index"] = target.glass.index
        facts[f"targets.{target.name}.camera"] = target.camera
    changeable = {"settle_s", "retries", "when_bad", "flat_pitch_mm", "flat_margin_mm", "temperature_c"}
    grid = config.scan.model_dump(exclude={*changeable, "limits", "grid"}, exclude_none=True)
    facts |= {f"scan.{key}": value for key, value in grid.items()}
    stated = config.scan.limits.model_dump(exclude_none=True)
    facts |= {f"scan.limits.{key}": value for key, value in stated.items()}
    if config.stage is not None:
        placed = {"driver", "coordinates", "sign_x", "sign_y", "offset_x_mm", "offset_y_mm"}
        facts |= {f"stage.{key}": value for key, value in config.stage.model_dump(include=placed).items()}
    return facts
