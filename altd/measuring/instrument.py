"""The protocol of an instrument, the kind of unit, for the measuring chain (docs/architecture.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from altd.records import Fault, MeanSpots, Quantities, Value
from altd.records.spots import Motion


@dataclass(frozen=True, slots=True)
class Solution:
    """The result of an instrument for a window: values by their quantities' keys.

    ``motions`` are those of this window alone, of the values that have a sigma; empty where the window shows
    none.
    """

    values: Mapping[str, Value]
    targets: Mapping[str, Mapping[str, Value]]
    motions: Mapping[str, Motion] = field(default_factory=dict)


class Instrument(Protocol):
    """A kind of unit. It knows quantities and how they follow from mean spots, not where frames come from."""

    @property
    def quantities(self) -> Quantities:
        """The quantities that it publishes."""

    @property
    def min_targets(self) -> int:
        """The number of targets with mean spots that ``solve`` needs; a window with fewer is not solved."""

    def solve(self, mean: MeanSpots) -> Solution | Fault:
        """The quantities of a window, or why there are none."""
