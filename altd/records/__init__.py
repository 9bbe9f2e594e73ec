"""Records that pass from camera to publisher: frozen, slotted, units in their names.

Conventions (pixel origin, frames, signs, invalid values) are those of ``docs/conventions.md``.
"""

from altd.records.faults import Fault, FaultCause, origin_faults
from altd.records.frames import CameraIdentity, ComplexArray, FloatArray, Frame, Origin, PixelArray
from altd.records.limits import Limits
from altd.records.measurement import Finding, Measurement, Quantities, Quantity, Value, counted, utc_text
from altd.records.spots import GLASS_INDEX, FrameSet, Glass, MeanSpots, NoSpot, Spot, SpotShape, TargetPoint

__all__ = [
    "GLASS_INDEX",
    "CameraIdentity",
    "ComplexArray",
    "Fault",
    "FaultCause",
    "Finding",
    "FloatArray",
    "Frame",
    "FrameSet",
    "Glass",
    "Limits",
    "MeanSpots",
    "Measurement",
    "NoSpot",
    "Origin",
    "PixelArray",
    "Quantities",
    "Quantity",
    "Spot",
    "SpotShape",
    "TargetPoint",
    "Value",
    "counted",
    "origin_faults",
    "utc_text",
]
