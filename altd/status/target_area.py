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
