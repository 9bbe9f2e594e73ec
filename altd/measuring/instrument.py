"""Protocol of an instrument, the kind of unit, for the measuring chain (docs/architecture.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from altd.records import Fault, MeanSpots, Quantities, Value
from altd.records.spots import Motion


@dataclass(frozen=True, slots=True)
class Solution:
    """Result of an instrument for a window: values by the keys of their quantities.

    ``motions`` holds the motion of the values that have a sigma, from this window alone; empty if the window
    shows none.
    """

    values: Mapping[str, Value]
    targets: Mapping[str, Mapping[str, Value]]
    motions: Mapping[str, Motion] = field(default_factory=dict)


class Instrument(Protocol):
    """Kind of unit. It derives quantities from mean spots, independent of the source of the frames."""

    @property
    def quantities(self) -> Quantities:
        """Quantities that it publishes."""

    @property
    def min_targets(self) -> int:
        """Number of targets with mean spots that ``solve`` needs; a window with fewer is not solved."""

    def solve(self, mean: MeanSpots) -> Solution | Fault:
        """Return the quantities of a window, or the fault that prevents them."""
