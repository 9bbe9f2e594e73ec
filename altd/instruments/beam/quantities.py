"""What the Active Laser Target publishes (docs/conventions.md); keys and decimals are contracts."""

from __future__ import annotations

from altd.instruments.beam.solver import Beam
from altd.records import Quantities, Quantity, Value

QUANTITIES = Quantities(
    instrument="beam",
    of_unit=(
        Quantity(
            "x_mm",
            "x",
            "mm",
            "displacement of the beam at the front target, to the right as seen along the beam",
            4,
        ),
        Quantity("y_mm", "y", "mm", "the same, upwards", 4),
        Quantity("yaw_deg", "yaw", "°", "direction of the beam, atan of its slope in x", 5),
        Quantity("pitch_deg", "pitch", "°", "atan of its slope in y", 5),
        Quantity("yaw_mm_per_m", "yaw", "mm/m", "1000 times the slope in x", 4, False, is_also="yaw_deg"),
        Quantity(
            "pitch_mm_per_m", "pitch", "mm/m", "1000 times the slope in y", 4, False, is_also="pitch_deg"
        ),
        Quantity(
            "roll_deg",
            "roll",
            "°",
            "a beam cannot show it: empty unless an inclinometer is fitted",
            5,
            False,
            True,
        ),
    ),
    of_target=(
        Quantity("x_mm", "x", "mm", "where the beam meets the target", 4, False),
        Quantity("y_mm", "y", "mm", "where the beam meets the target", 4, False),
    ),
)


def values_of(beam: Beam) -> dict[str, Value]:
    """The quantities of a beam, by their keys; roll is none of them."""
    return {
        "x_mm": Value(beam.x_mm, beam.sigma_x_mm),
        "y_mm": Value(beam.y_mm, beam.sigma_y_mm),
        "yaw_deg": Value(beam.yaw_deg, beam.sigma_yaw_deg),
        "pitch_deg": Value(beam.pitch_deg, beam.sigma_pitch_deg),
        "yaw_mm_per_m": Value(beam.yaw_mm_per_m),
        "pitch_mm_per_m": Value(beam.pitch_mm_per_m),
    }
