"""The parts and the past of a unit as text for a technician: spots, components, events, trends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from altd.history.history import History, NoHistoryError
from altd.history.records import SummaryPoint
from altd.publish.serial.words import NO_MEASUREMENT, WIDTH, ascii_unit, component_lines, hanging
from altd.records import Quantities
from altd.status.calibration_summary import CalibrationFigures
from altd.status.conditions import Condition
from altd.status.event_log import SHOWN_KINDS, Event, EventLog
from altd.status.health import MEASURING
from altd.status.target_area import TargetArea
from altd.status.unit import UnitView

_ABOUT_CALIBRATION = (Condition.CALIBRATION_DUE, Condition.CLOCK_WRONG)


def spots_text(view: UnitView) -> str:
    """For each target the position of the spot, and the report of its camera."""
    if (measurement := view.measurement) is None:
        return NO_MEASUREMENT
    measuring = view.component(MEASURING)
    found = measuring.findings if measuring else {}
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
        if target in found:
            lines.append(hanging("", found[target], width))
    return "\n".join(lines)


def health_text(view: UnitView) -> str:
    """Every component with its message, counters and figures."""
    return "\n".join(component_lines(view.components, whole=True)) or "nothing has started so far"


def calibration_text(view: UnitView) -> str:
    """Calibration: date and source, file, causes with remedies, expected sigma and valid area."""
    lines = [hanging("calibration", view.facts.calibration or "not known", 13)]
    for shown in view.causes:
        kind = shown.cause.kind
        if kind in _ABOUT_CALIBRATION:
            lines.append(hanging("  -", f"{kind.brief} ({shown.cause.detail}): {shown.cause.remedy}", 4))
    if (figures := view.calibration) is not None:
        file = figures.file
        lines.append(hanging("  file", f"{file.name}, SHA-256 {file.sha256 or 'not known'}", 13))
        lines.append(hanging("  expected", _expected(figures, view.quantities), 13))
    lines += [hanging(f"  {target.name}", _where(target), 13) for target in view.targets]
    return "\n".join(lines)


def _expected(figures: CalibrationFigures, quantities: Quantities) -> str:
    """Expected sigma of a measurement, with the decimals of the report and the page."""
    sigmas = [
        f"{quantity.label} {sigma:.4f} {ascii_unit(quantity)}"
        for quantity in quantities.of_unit
        if (sigma := figures.expected_sigma.get(quantity.key)) is not None
    ]
    return f"sigma of {figures.exposures} exposures: {', '.join(sigmas) or 'not known'}"


def _where(target: TargetArea) -> str:
    text = f"z {target.z_mm:.1f} mm"
    if not target.valid_mm:
        return text
    (left, right), (low, high) = ((min(side), max(side)) for side in zip(*target.valid_mm, strict=True))
    return f"{text}, valid within x {left:.1f} to {right:.1f}, y {low:.1f} to {high:.1f} mm"


SHOWN_EVENTS = 12
ROWS = 12
SPANS_S = {"hour": 3600, "day": 86_400, "month": 30 * 86_400}
_TIMES = {"hour": "%H:%M:%S", "day": "%d, %H:%M", "month": "%m-%d, %H:%M"}


@dataclass(frozen=True, slots=True)
class Past:
    """The past that a daemon has stored; ``now`` is its time of day, None: not known."""

    events: EventLog
    history: History
    now: Callable[[], datetime | None]


def log_text(past: Past) -> str:
    """The newest events, the newest first."""
    events = past.events.after(0)[-SHOWN_EVENTS:]
    return "\n".join(map(_event_line, reversed(events))) or "nothing has happened so far"


async def history_text(past: Past, quantities: Quantities, span: str) -> str:
    """Return the means of the last hour, day or month in equal steps, the newest last, or why not."""
    now = past.now()
    if now is None:
        return "no history: the time of day is not known"
    to_us = int(now.timestamp() * 1e6)
    from_us = max(to_us - SPANS_S[span] * 10**6, 0)
    keys = [quantity.key for quantity in quantities.main]
    try:
        trend = await past.history.ask(lambda reader: reader.trend(from_us, to_us, ROWS, keys))
    except (NoHistoryError, ValueError) as error:
        return hanging("", f"no history: {error}", 2).strip()
    if not trend.points:
        return f"nothing was measured in the last {span}"
    head = "".join(f"{f'{quantity.label} {ascii_unit(quantity)}':>10}" for quantity in quantities.main)
    rows = [_row(point, quantities, _TIMES[span]) for point in trend.points]
    return "\n".join([f"{'from (UTC)':<13}{'valid':>6}{head}", *rows])


def _row(point: SummaryPoint, quantities: Quantities, form: str) -> str:
    begun = datetime.fromtimestamp(point.t_us / 1e6, UTC).strftime(form)
    share = f"{100 * point.n_valid // point.n} %" if point.n else "-"
    numbers = ""
    for quantity in quantities.main:
        value = point.values.get(quantity.key)
        numbers += f"{'-':>10}" if value is None else f"{value.mean:10.{quantity.decimals - 1}f}"
    return f"{begun:<13}{share:>6}{numbers} {point.lost_to}"[:WIDTH].rstrip()


def _event_line(event: Event) -> str:
    of = f" {event.of}" if event.of else ""
    alike = f" ({event.held_back} similar ones before)" if event.held_back else ""
    time = event.time.astimezone(UTC).strftime("%m-%d %H:%M:%S")
    return hanging(time, f"{SHOWN_KINDS.get(event.kind, event.kind)}{of}: {event.text}{alike}", 15)
