"""The area of each target in which a spot is valid, from the calibration."""

from __future__ import annotations

import numpy as np

from altd.config import Config
from altd.mapping.hull import edge_lines
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.status.target_area import TargetArea

_DECIMALS = 2
_MIN_TURN = 1e-6
"""Sine of the angle between two edges; below it they are one edge with a node on it."""


def target_areas_of(config: Config, calibration: Calibration) -> tuple[TargetArea, ...]:
    """The targets of the config, in beam order."""
    known = [(target, calibration.target(target.name)) for target in config.targets]
    return tuple(
        TargetArea(target.name, target.z_mm, _outline_mm(fitted))
        for target, fitted in known
        if fitted is not None
    )


def _outline_mm(target: TargetCalibration) -> tuple[tuple[float, float], ...]:
    """The hull of the map's nodes, each edge moved outwards by the margin in which the map still holds.

    That is where ``InverseMap.outside_mm`` is the margin: its corners are those of neighbouring edges.
    """
    edges = edge_lines(target.map.hull_mm)
    corners = []
    for (nx, ny, offset), (before_x, before_y, before) in zip(edges, np.roll(edges, 1, axis=0), strict=True):
        turn = before_x * ny - before_y * nx
        if turn > _MIN_TURN:
            wide, wide_before = offset + target.map.margin_mm, before + target.map.margin_mm
            x = (ny * wide_before - before_y * wide) / turn
            y = (before_x * wide - nx * wide_before) / turn
            corners.append((round(float(x), _DECIMALS), round(float(y), _DECIMALS)))
    return tuple(corners)
