"""All ways to disturb measurements, by name; a module for each part that they disturb."""

from collections.abc import Mapping
from typing import Protocol, TypeVar

from altd.errors import BadInputError
from benchmarks.campaign.way import Draw, Registry, Spoil, Way
from benchmarks.campaign.ways import ambient, cameras, frames, numbers, spots, surfaces, times

CLEAN, ANOTHER_UNIT = "clean", "another_unit"


def _nothing(draw: Draw) -> Spoil:
    return Spoil("nothing disturbed")


_GOOD, _FOREIGN = Registry("good"), Registry("cameras")
_GOOD.row(CLEAN, "No disturbance.", _nothing)
_GOOD.row("clean_driving", "No disturbance.", _nothing, moving=True)
_FOREIGN.row(
    ANOTHER_UNIT,
    "Frames of another unit with this unit's calibration.",
    lambda draw: Spoil("its frames under this unit's calibration"),
)
_REGISTRIES = (
    *(_GOOD, spots.WAYS, surfaces.WAYS, ambient.WAYS, frames.WAYS),
    *(cameras.WAYS, _FOREIGN, times.WAYS, numbers.WAYS),
)
WAYS: dict[str, Way] = {way.name: way for registry in _REGISTRIES for way in registry.ways}


class _Named(Protocol):
    """A way, or a fault of the fault suite."""

    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def summary(self) -> str: ...


_T = TypeVar("_T", bound=_Named)


def chosen(names: str, known: Mapping[str, _T], option: str, noun: str) -> list[_T]:
    """Ways or faults with these names or kinds, comma-separated; all if empty. Raises BadInputError."""
    found: list[_T] = []
    for name in names.split(",") if names else known:
        named = [one for one in known.values() if name in (one.name, one.kind)]
        if not named:
            kinds = dict.fromkeys(one.kind for one in known.values())
            raise BadInputError(option, f"unknown {noun} {name!r}; groups are {', '.join(kinds)}")
        found += named
    return list(dict.fromkeys(found))


def listed(known: Mapping[str, _Named]) -> str:
    """Lines for ``--list``."""
    return "\n".join(f"{one.kind:<9} {one.name:<22} {one.summary}" for one in known.values())
