"""The last check before publishing: finite and ordered numbers of a beam that the unit can measure."""

from __future__ import annotations

import math
from collections.abc import Iterator

from altd.reasons import Reason
from altd.records import Beam, Fault, Measurement

MAX_YAW_MM_PER_M = 110.0
MAX_PITCH_MM_PER_M = 250.0
"""The ranges that are stated for the unit (App. A.1)."""
_MARGIN_SIGMAS = 3.0
_MAX_MARGIN_MM_PER_M = 1.0
"""The accuracy that is required (App. A.1). A beam may lie beyond a range by its uncertainty, up to this."""


def range_fault(beam: Beam) -> Fault | None:
    """Why a beam of the unit frame, before signs and offsets, is none that the unit is made for.

    One that is not finite is left to the gate.
    """
    if not (math.isfinite(beam.yaw_deg) and math.isfinite(beam.pitch_deg)):
        return None
    for name, slope, sigma_deg, limit in (
        ("yaw", beam.yaw_mm_per_m, beam.sigma_yaw_deg, MAX_YAW_MM_PER_M),
        ("pitch", beam.pitch_mm_per_m, beam.sigma_pitch_deg, MAX_PITCH_MM_PER_M),
    ):
        sigma = math.radians(sigma_deg) * (1000.0 + slope * slope / 1000.0)
        if abs(slope) > limit + min(_MARGIN_SIGMAS * sigma, _MAX_MARGIN_MM_PER_M):
            detail = f"{name} is {slope:.1f} mm/m, the unit measures up to {limit:g}"
            return Fault(Reason.OUT_OF_RANGE, detail=detail)
    return None


class Gate:
    """Lets measurements through; one that cannot be true loses its numbers and says ``check_failed``.

    It remembers the last valid one: a later measurement has a larger sequence and a later last exposure.
    After one that was out of order the order counts from there, or a single lie would stop all that follows.
    """

    def __init__(self) -> None:
        self._last: Measurement | None = None

    def admit(self, measurement: Measurement) -> Measurement:
        """The measurement itself, or without its numbers and with the reason."""
        if measurement.beam is None:
            return measurement
        before, self._last = self._last, measurement
        doubt = next(_doubts(measurement, before), None)
        if doubt is None:
            return measurement
        warnings = tuple(fault for fault in measurement.status if fault.reason.is_warning)
        return measurement.without_numbers((Fault(Reason.CHECK_FAILED, detail=doubt), *warnings))


def _doubts(measurement: Measurement, before: Measurement | None) -> Iterator[str]:
    beam = measurement.beam
    assert beam is not None  # noqa: S101  an invalid one has nothing to doubt
    values = {name: getattr(beam, name) for name in Beam.__dataclass_fields__}
    for target, point in measurement.points_mm.items():
        values |= {f"{target}.x_mm": point[0], f"{target}.y_mm": point[1]} if point else {target: math.nan}
    if measurement.roll_deg is not None:
        values["roll_deg"] = measurement.roll_deg
    for name, value in values.items():
        if not math.isfinite(value):
            yield f"{name} is {value}"
        elif name.startswith("sigma_") and value <= 0.0:
            yield f"{name} is {value:g}"
    if measurement.frames < 1:
        yield f"it is the mean of {measurement.frames} exposures"
    if before is not None:
        if measurement.sequence <= before.sequence:
            yield f"sequence {measurement.sequence} does not follow {before.sequence}"
        if measurement.light_ns <= before.light_ns:
            yield f"exposed {(before.light_ns - measurement.light_ns) * 1e-9:g} s before the one before it"
