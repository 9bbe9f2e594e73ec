"""The measurement that the pages of all faces show, so that a reader can compare them."""

from __future__ import annotations

from datetime import UTC, datetime

from altd.instruments.beam.quantities import QUANTITIES, values_of
from altd.instruments.beam.solver import Beam
from altd.records import Measurement, Value

MEASURED = Measurement(
    sequence=160,
    t_ns=8_000_000_000,
    time=datetime(2026, 11, 20, 8, 15, 30, 125_000, UTC),
    frames=20,
    quantities=QUANTITIES,
    values=values_of(Beam(10.012, 4.987, 1.1459, -1.7184, 0.004, 0.004, 0.0011, 0.0011)),
    targets={
        "front": {"x_mm": Value(10.012), "y_mm": Value(4.987)},
        "rear": {"x_mm": Value(15.613), "y_mm": Value(-3.413)},
    },
)
