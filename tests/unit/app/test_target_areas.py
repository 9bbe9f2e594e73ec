"""The areas of the targets: inside is what the maps take."""

from __future__ import annotations

import math

import numpy as np
from support.played_unit import PlayedUnit

from altd.app.calibration_summary import target_areas_of
from altd.app.settings import load_settings
from altd.calibration.file import load_calibration
from altd.status.target_area import as_object


def inside(corners: tuple[tuple[float, float], ...], place: tuple[float, float]) -> bool:
    """By the winding of a convex, counter-clockwise outline."""
    ends = [*corners[1:], *corners[:1]]
    return all(
        (x1 - x0) * (place[1] - y0) - (y1 - y0) * (place[0] - x0) >= 0
        for (x0, y0), (x1, y1) in zip(corners, ends, strict=True)
    )


def test_a_spot_is_valid_inside_and_nowhere_outside(played_unit: PlayedUnit) -> None:
    calibration = load_calibration(played_unit.calibration, "TEST-1")
    areas = target_areas_of(load_settings(played_unit.config), calibration)
    assert [area.name for area in areas] == ["front", "rear"]
    for area, known in zip(areas, calibration.targets, strict=True):
        for turn in np.linspace(0.0, 2 * math.pi, 60):
            for radius in np.arange(5.0, 130.0, 2.5):
                place = (float(radius * math.cos(turn)), float(radius * math.sin(turn)))
                outside_mm = float(known.inverse.outside_mm(*place))
                if outside_mm <= known.map.margin_mm - 0.02:
                    assert inside(area.valid_mm, place), place
                if outside_mm > known.map.margin_mm + 0.02:
                    assert not inside(area.valid_mm, place), place
    document = as_object(areas)
    assert document["area_mm"] == [140.0, 110.0]
