"""The measurement that the pages of all faces show, so that a reader can compare them."""

from __future__ import annotations

from datetime import UTC, datetime

from altd.records import Beam, Measurement

MEASURED = Measurement(
    sequence=160,
    t_ns=8_000_000_000,
    time=datetime(2026, 11, 20, 8, 15, 30, 125_000, UTC),
    frames=20,
    beam=Beam(10.012, 4.987, 1.1459, -1.7184, 0.004, 0.004, 0.0011, 0.0011),
    points_mm={"front": (10.012, 4.987), "rear": (15.613, -3.413)},
)
