"""Area in which a target is measured, for drawings of it."""

from __future__ import annotations

from dataclasses import dataclass

AREA_MM = (140.0, 110.0)
"""Width and height of the area that the unit is made for (App. A.1), centred on the unit frame's zero, mm."""


@dataclass(frozen=True, slots=True)
class TargetArea:
    """One target; ``valid_mm`` are the corners of the valid spot area in the unit frame.

    ``camera`` is the name of its camera.
    """

    name: str
    z_mm: float
    valid_mm: tuple[tuple[float, float], ...]
    camera: str = ""


def as_object(areas: tuple[TargetArea, ...]) -> dict[str, object]:
    """Return the targets in beam order, as plain JSON types."""
    return {
        "area_mm": list(AREA_MM),
        "targets": [
            {"name": area.name, "z_mm": area.z_mm, "valid_mm": [list(corner) for corner in area.valid_mm]}
            for area in areas
        ],
    }
