"""Protocol of an instrument, the kind of unit, for the measuring chain (docs/architecture.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

from altd.records import Fault, MeanSpots, Quantities, Value
from altd.records.joint import Joint
from altd.records.spots import CrossCheckedBeam, Motion


@dataclass(frozen=True, slots=True)
class Solution:
    """Result of an instrument for a window: values by the keys of their quantities.

    ``motions`` holds the motion of the values that have a sigma, from this window alone; empty if the window
    shows none. ``joint`` is the values' joint uncertainty, ``cross_check`` the beam by the second maps.
    """

    values: Mapping[str, Value]
    targets: Mapping[str, Mapping[str, Value] | None]
    motions: Mapping[str, Motion] = field(default_factory=dict)
    joint: Joint | None = field(default=None, compare=False)
    cross_check: CrossCheckedBeam | None = None

    def with_motion_in_sigma(self) -> Solution | None:
        """Return the values with sigmas about the true value at their time, vibration included.

        None: the motion of a quantity with a sigma is not known.
        """
        values = dict(self.values)
        for key, value in self.values.items():
            if value.sigma is not None:
                since = self.motions[key].variance_since(0.0) if key in self.motions else None
                if since is None:
                    return None
                values[key] = Value(value.value, math.sqrt(value.sigma**2 + since))
        motions = {key: replace(motion, is_in_sigma=True) for key, motion in self.motions.items()}
        joint = self.joint and self.joint.with_motion(self.motions)
        return replace(self, values=values, motions=motions, joint=joint)


NO_SOLUTION = Solution({}, {})


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
