"""Measurements for the tests of boards and publishers."""

from __future__ import annotations

from altd.reasons import Reason
from altd.records import Beam, Fault, Measurement

BEAM = Beam(10.012, 4.987, 1.1459, -1.7184, 0.004, 0.004, 0.0011, 0.0011)


def measurement(sequence: int = 160, t_ns: int = 8_000_000_000, *reasons: Reason) -> Measurement:
    """A valid measurement, or an invalid one when a reason says so."""
    invalid = any(not reason.is_warning for reason in reasons)
    return Measurement(
        sequence=sequence,
        t_ns=t_ns,
        time=None,
        frames=0 if invalid else 20,
        beam=None if invalid else BEAM,
        points_mm={"front": None, "rear": None}
        if invalid
        else {"front": (10.012, 4.987), "rear": (15.613, -3.413)},
        status=tuple(Fault(reason) for reason in reasons),
    )
