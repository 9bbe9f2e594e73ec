"""The beam by the targets' second maps, in the measurement object: for diagnosis alone."""

from __future__ import annotations

from typing import Any

from altd.records import Measurement
from altd.status.answer import Answer

_OF_BEAM = {"yaw_deg": 5, "pitch_deg": 5}
_OF_SPOT = {"u_px": 3, "v_px": 3, "x_mm": 4, "y_mm": 4}
"""Decimals by key."""


class CrossCheckedTarget(Answer):
    """The mean spot on a target, and the beam's place there by the target's second map."""

    u_px: float | None
    """Mean spot, to the right of the centre of the first pixel; a corrected drift of the camera is off it."""
    v_px: float | None
    """The same, downwards."""
    x_mm: float | None
    """Intersection of the beam with the target by the second map, in the unit frame."""
    y_mm: float | None
    """The same, upwards."""


class CrossCheckedMeasurement(Answer):
    """The beam by the targets' second maps, for diagnosis: do not control by it. null: not valid."""

    yaw_deg: float | None
    """Yaw of the line through these places, with sign and offset of `yaw_deg`."""
    pitch_deg: float | None
    """Its pitch, likewise."""
    targets: dict[str, CrossCheckedTarget]


def cross_check_object(measurement: Measurement) -> dict[str, Any]:
    """Return ``cross_check`` as ``CrossCheckedMeasurement``; empty for an instrument that has none."""
    if not measurement.quantities.has_cross_check:
        return {}
    beam = measurement.cross_check
    spots = {target: beam and beam.spots.get(target) for target in measurement.targets}
    targets = {target: _rounded(spot, _OF_SPOT) for target, spot in spots.items()}
    return {"cross_check": {**_rounded(beam, _OF_BEAM), "targets": targets}}


def _rounded(record: object, decimals: dict[str, int]) -> dict[str, float | None]:
    return {key: None if record is None else round(getattr(record, key), of) for key, of in decimals.items()}
