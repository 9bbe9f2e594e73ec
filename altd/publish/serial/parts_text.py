"""The parts of a unit in the words of a technician: spots, components, calibration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from altd.publish.serial.words import NO_MEASUREMENT, component_lines, hanging
from altd.records import Measurement, Quantities
from altd.status.conditions import Condition
from altd.status.health import MEASURING, Health
from altd.status.target_area import TargetArea

_ABOUT_CALIBRATION = (Condition.CALIBRATION_DUE, Condition.CLOCK_WRONG)


def spots_text(measurement: Measurement | None, health: Health) -> str:
    """Each target: where the beam meets it, and what its camera sees."""
    if measurement is None:
        return NO_MEASUREMENT
    said = next((part.message for part in health if part.name == MEASURING), "").split("; ")
    width = max(map(len, measurement.targets), default=0) + 2
    lines = []
    for target, values in measurement.targets.items():
        place = "no place known"
        if values:
            place = ", ".join(
                f"{quantity.label} {values[quantity.key].value:.{quantity.decimals - 1}f} {quantity.unit}"
                for quantity in measurement.quantities.of_target
                if quantity.key in values
            )
        lines.append(hanging(target, place, width))
        seen = [part.removeprefix(f"{target}: ") for part in said if part.startswith(f"{target}: ")]
        lines += [hanging("", text, width) for text in seen]
    return "\n".join(lines)


def health_text(health: Health) -> str:
    """Every component with all that it says, counts and measures of itself."""
    return "\n".join(component_lines(list(health), whole=True)) or "nothing has started so far"


def calibration_text(health: Health, quantities: Quantities) -> str:
    """When and from what it was made, its file, what is to be done about it, what it is worth and where."""
    lines = [hanging("calibration", health.facts.get("calibration", "not known"), 13)]
    report = health.state()
    for shown in () if report is None else report.causes:
        kind = shown.cause.kind
        if kind in _ABOUT_CALIBRATION:
            lines.append(hanging("  -", f"{kind.brief} ({shown.cause.detail}): {kind.remedy}", 4))
    if summary := health.calibration.summary:
        file = summary["file"]
        lines.append(hanging("  file", f"{file['name']}, SHA-256 {file['sha256'] or 'not known'}", 13))
        lines.append(hanging("  expected", _expected(summary, quantities), 13))
    lines += [hanging(f"  {target.name}", _where(target), 13) for target in health.targets]
    return "\n".join(lines)


def _expected(summary: Mapping[str, Any], quantities: Quantities) -> str:
    """The sigma of a measurement, with the decimals of the report and the page."""
    sigmas = [
        f"{quantity.label} {sigma:.4f} {quantity.unit.replace('°', 'deg')}"
        for quantity in quantities.of_unit
        if (sigma := summary["expected_sigma"].get(quantity.key)) is not None
    ]
    return f"sigma of {summary['exposures']} exposures: {', '.join(sigmas) or 'not known'}"


def _where(target: TargetArea) -> str:
    text = f"z {target.z_mm:.1f} mm"
    if not target.valid_mm:
        return text
    (left, right), (low, high) = ((min(side), max(side)) for side in zip(*target.valid_mm, strict=True))
    return f"{text}, valid within x {left:.1f} to {right:.1f}, y {low:.1f} to {high:.1f} mm"
