"""What a calibration scan is to do: the nodes in their order, and what must not change when it is resumed."""

from __future__ import annotations

from dataclasses import dataclass

from altd.config import Config, Scan


@dataclass(frozen=True, slots=True)
class Node:
    """One place of the grid, mm in the unit frame."""

    column: int
    row: int
    x_mm: float
    y_mm: float

    def __str__(self) -> str:
        return f"x {self.x_mm:g} y {self.y_mm:g} mm"


def nodes_of(scan: Scan) -> tuple[Node, ...]:
    """The grid's nodes in the order in which the stage visits them."""
    nodes = []
    for row in range(scan.rows):
        back = scan.order == "serpentine" and row % 2 == 1
        columns = range(scan.columns)
        for column in reversed(columns) if back else columns:
            x_mm = scan.centre_x_mm + (column - (scan.columns - 1) / 2) * scan.pitch_mm
            y_mm = scan.centre_y_mm + (row - (scan.rows - 1) / 2) * scan.pitch_mm
            nodes.append(Node(column, row, x_mm, y_mm))
    return tuple(nodes)


Facts = dict[str, str | int | float]
"""Settings by the name that they have in the config."""


def fingerprint(config: Config) -> Facts:
    """What two parts of one scan must have in common.

    How the stage is reached, how fast it goes, and how patient the scan is may change in between; where the
    nodes and the stage's coordinates lie may not.
    """
    facts: Facts = {"unit.serial": config.unit.serial}
    for target in config.targets:
        facts[f"targets.{target.name}.z_mm"] = target.z_mm
        facts[f"targets.{target.name}.camera"] = target.camera
    grid = config.scan.model_dump(exclude={"settle_s", "retries", "when_bad"})
    facts |= {f"scan.{key}": value for key, value in grid.items()}
    if config.stage is not None:
        placed = {"driver", "coordinates", "sign_x", "sign_y", "offset_x_mm", "offset_y_mm"}
        facts |= {f"stage.{key}": value for key, value in config.stage.model_dump(include=placed).items()}
    return facts
