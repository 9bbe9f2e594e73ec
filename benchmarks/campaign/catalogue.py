"""All ways to disturb measurements, by name."""

from __future__ import annotations

from altd.errors import BadInputError
from benchmarks.campaign.way import Draw, Spoil, Way
from benchmarks.campaign.ways import (
    ambient,
    cameras,
    frame_order,
    grey_values,
    numbers,
    spots,
    surfaces,
    times,
)

CLEAN, ANOTHER_UNIT = "clean", "another_unit"


def _nothing(draw: Draw) -> Spoil:
    """No disturbance."""
    return Spoil("nothing disturbed")


def _foreign(draw: Draw) -> Spoil:
    """Frames of another unit with this unit's calibration."""
    return Spoil("its frames under this unit's calibration")


WAYS: dict[str, Way] = {
    way.name: way
    for way in (
        Way(CLEAN, "good", _nothing),
        Way("clean_driving", "good", _nothing, moving=True),
        *spots.WAYS.ways,
        *surfaces.WAYS.ways,
        *ambient.WAYS.ways,
        *grey_values.WAYS.ways,
        *frame_order.WAYS.ways,
        *cameras.WAYS.ways,
        Way(ANOTHER_UNIT, "cameras", _foreign),
        *times.WAYS,
        *numbers.WAYS,
    )
}


def chosen(names: str) -> list[Way]:
    """Ways with these names or kinds, comma-separated; all if empty. Raises BadInputError."""
    if not names:
        return list(WAYS.values())
    found = []
    for name in names.split(","):
        of_kind = [way for way in WAYS.values() if name in (way.name, way.kind)]
        if name == spots.photographed_beam.__name__ and not of_kind:
            raise BadInputError("--ways", f"{name} needs the photographs in {spots.BEAMS}")
        if not of_kind:
            kinds = dict.fromkeys(way.kind for way in WAYS.values())
            raise BadInputError("--ways", f"unknown way {name!r}; kinds are {', '.join(kinds)}")
        found += of_kind
    return list(dict.fromkeys(found))
