"""How long a Video4Linux camera exposes, where its driver says so in a unit of time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

from altd.devices.v4l2 import abi
from altd.devices.v4l2.controls import Control
from altd.devices.v4l2.node import Node
from altd.ports import ExposureRange

_EXPOSURE_UNIT_MS = 0.1
_MANUAL = 1
_KEEP_RATE = 0


@dataclass(frozen=True, slots=True)
class ExposureTime:
    """``V4L2_CID_EXPOSURE_ABSOLUTE``, in units of 100 µs, and the controls that must let go of it.

    ``V4L2_CID_EXPOSURE`` is not used, nor is any gain: the one counts lines or whatever a driver's author
    chose, the other has no unit at all.
    """

    time: Control
    automatic: Control | None
    may_slow_down: Control | None

    @classmethod
    def of(cls, controls: Iterable[Control]) -> Self | None:
        """Out of a camera's controls; None when it cannot be told an exposure in milliseconds."""
        by_number = {control.number: control for control in controls}
        time = by_number.get(abi.V4L2_CID_EXPOSURE_ABSOLUTE)
        if time is None or not time.writes or time.maximum < 1:
            return None
        automatic = by_number.get(abi.V4L2_CID_EXPOSURE_AUTO)
        return cls(time, automatic, by_number.get(abi.V4L2_CID_EXPOSURE_AUTO_PRIORITY))

    @property
    def range(self) -> ExposureRange:
        """From the shortest to the longest; without a gain."""
        return ExposureRange(
            max(1, self.time.minimum) * _EXPOSURE_UNIT_MS, self.time.maximum * _EXPOSURE_UNIT_MS, 0.0, 0.0
        )

    def now_ms(self, node: Node) -> float | None:
        """The exposure, or None while the camera chooses it by itself; raises OSError."""
        if self.automatic is not None and self.automatic.value(node) != _MANUAL:
            return None
        return self.time.value(node) * _EXPOSURE_UNIT_MS

    def set(self, node: Node, exposure_ms: float) -> float:
        """Expose as nearly so as the camera can, and say how; raises CameraRefusedError, OSError."""
        if self.automatic is not None and self.automatic.value(node) != _MANUAL:
            self.automatic.set(node, _MANUAL)
        if self.may_slow_down is not None and self.may_slow_down.writes:
            self.may_slow_down.set(node, _KEEP_RATE)
        units = self.units(exposure_ms)
        self.time.set(node, units)
        return units * _EXPOSURE_UNIT_MS

    def units(self, exposure_ms: float) -> int:
        """The nearest value that the control takes."""
        first, step = max(1, self.time.minimum), max(1, self.time.step)
        last = first + (self.time.maximum - first) // step * step
        nearest = first + round((exposure_ms / _EXPOSURE_UNIT_MS - first) / step) * step
        return min(max(nearest, first), last)
