"""The measurement object: one line of ``altd replay``, the body of HTTP and, later, MQTT (DESIGN §4)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from altd.files.documents import line_of
from altd.records import Measurement, Quantity, Value, utc_text

_KNOWN_DECIMALS = 4
"""Of where a stage put the beam, mm, and of what a measurement differs from it."""


def as_object(measurement: Measurement) -> dict[str, Any]:
    """The measurement as plain JSON types; what is not known is None, never a number."""
    quantities = measurement.quantities
    return {
        "sequence": measurement.sequence,
        "time": None if measurement.time is None else utc_text(measurement.time),
        "t_s": round(measurement.t_ns * 1e-9, 6),
        "frames": measurement.frames,
        "valid": measurement.valid,
        "status": [str(fault) for fault in measurement.status],
        **_values(quantities.of_unit, measurement.values),
        "sigma": {
            quantity.key: _rounded(measurement.sigma(quantity.key), quantity.decimals)
            for quantity in quantities.of_unit
            if quantity.has_sigma
        },
        **{
            target: _values(quantities.of_target, values or {})
            for target, values in measurement.targets.items()
        },
    }


def as_scan_object(measurement: Measurement, known_mm: tuple[float, float]) -> dict[str, Any]:
    """The same of a scan, where the stage put the beam at (x, y) mm on every target: with the difference.

    ``known_x_mm``, ``known_y_mm``, and measured minus known as ``dx_mm``, ``dy_mm``, of the displacement
    and of each target.
    """
    document = as_object(measurement)
    axes = dict(zip("xy", known_mm, strict=True))
    for target, values in measurement.targets.items():
        document[target] |= _difference(values or {}, axes)
    document |= {f"known_{axis}_mm": round(known, _KNOWN_DECIMALS) for axis, known in axes.items()}
    return document | _difference(measurement.values, axes)


def as_line(measurement: Measurement) -> str:
    """The measurement as one line of JSON, without the line end; NaN is refused, not written."""
    return line_of(as_object(measurement))


def _values(quantities: tuple[Quantity, ...], values: Mapping[str, Value]) -> dict[str, float | None]:
    known = {key: value.value for key, value in values.items()}
    return {quantity.key: _rounded(known.get(quantity.key), quantity.decimals) for quantity in quantities}


def _difference(values: Mapping[str, Value], known_mm: Mapping[str, float]) -> dict[str, float | None]:
    """Measured minus known, of x and y."""
    return {
        f"d{axis}_mm": _rounded(
            values[f"{axis}_mm"].value - known if f"{axis}_mm" in values else None, _KNOWN_DECIMALS
        )
        for axis, known in known_mm.items()
    }


def _rounded(value: float | None, decimals: int) -> float | None:
    return None if value is None else round(value, decimals)
