"""The measurement object: one line of ``altd replay``, the body of HTTP and, later, MQTT (DESIGN §4)."""

from __future__ import annotations

from typing import Any

from altd.files.documents import line_of
from altd.records import Measurement, utc_text

MM_DIGITS = 4
DEG_DIGITS = 5


def as_object(measurement: Measurement) -> dict[str, Any]:
    """The measurement as plain JSON types; what is not known is None, never a number."""

    def rounded(value: float | None, digits: int) -> float | None:
        return None if value is None else round(value, digits)

    def of_beam(attribute: str) -> float | None:
        digits = DEG_DIGITS if attribute.endswith("_deg") else MM_DIGITS
        return rounded(getattr(measurement.beam, attribute, None), digits)

    return {
        "sequence": measurement.sequence,
        "time": None if measurement.time is None else utc_text(measurement.time),
        "t_s": round(measurement.t_ns * 1e-9, 6),
        "frames": measurement.frames,
        "valid": measurement.valid,
        "status": [str(fault) for fault in measurement.status],
        "x_mm": of_beam("x_mm"),
        "y_mm": of_beam("y_mm"),
        "yaw_deg": of_beam("yaw_deg"),
        "pitch_deg": of_beam("pitch_deg"),
        "yaw_mm_per_m": of_beam("yaw_mm_per_m"),
        "pitch_mm_per_m": of_beam("pitch_mm_per_m"),
        "roll_deg": rounded(measurement.roll_deg, DEG_DIGITS),
        "sigma": {
            "x_mm": of_beam("sigma_x_mm"),
            "y_mm": of_beam("sigma_y_mm"),
            "yaw_deg": of_beam("sigma_yaw_deg"),
            "pitch_deg": of_beam("sigma_pitch_deg"),
        },
        **{
            target: {
                "x_mm": None if point is None else round(point[0], MM_DIGITS),
                "y_mm": None if point is None else round(point[1], MM_DIGITS),
            }
            for target, point in measurement.points_mm.items()
        },
    }


def as_scan_object(measurement: Measurement, known_mm: tuple[float, float]) -> dict[str, Any]:
    """The same of a scan, where the stage put the beam at (x, y) mm on every target: with the difference.

    ``known_x_mm``, ``known_y_mm``, and measured minus known as ``dx_mm``, ``dy_mm``, of the displacement
    and of each target.
    """
    of_beam = as_object(measurement)
    known = {f"known_{axis}_mm": round(value, MM_DIGITS) for axis, value in zip("xy", known_mm, strict=True)}
    beam, points_mm = measurement.beam, measurement.points_mm
    displacement_mm = None if beam is None else (beam.x_mm, beam.y_mm)
    for target, point in points_mm.items():
        of_beam[target] |= _difference(point, known_mm)
    return of_beam | known | _difference(displacement_mm, known_mm)


def _difference(
    measured_mm: tuple[float, float] | None, known_mm: tuple[float, float]
) -> dict[str, float | None]:
    if measured_mm is None:
        return {"dx_mm": None, "dy_mm": None}
    x_mm, y_mm = measured_mm
    return {"dx_mm": round(x_mm - known_mm[0], MM_DIGITS), "dy_mm": round(y_mm - known_mm[1], MM_DIGITS)}


def as_line(measurement: Measurement) -> str:
    """The measurement as one line of JSON, without the line end; NaN is refused, not written."""
    return line_of(as_object(measurement))
