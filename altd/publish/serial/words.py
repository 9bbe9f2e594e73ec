"""Measurement and health as text for a technician, 80 columns of ASCII, lines separated by LF."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

from altd.errors import shown_in
from altd.publish.serial.advice import advice, component_steps
from altd.reasons import Signal
from altd.records import Fault, Measurement, Quantities, Quantity, counted, utc_text
from altd.status.availability import span_text
from altd.status.cause import ShownCause, StateReport
from altd.status.conditions import Condition
from altd.status.health import MEASURING, ComponentReport, State, duration
from altd.status.unit import UnitView
from altd.status.zero import ZeroState

_SHOWN_BY_COMPONENTS = {
    Condition.CAMERA_FAILED,
    Condition.CAMERA_DEGRADED,
    Condition.CAMERA_AUTOMATIC,
    Condition.RECORDING_ENDED,
    Condition.FACE_FAILED,
    Condition.LAMPS_FAILED,
    Condition.INDICATORS_FAILED,
    Condition.SENSOR_FAILED,
    Condition.COMPONENT_FAILED,
    Condition.COMPONENT_DEGRADED,
}
"""Causes that the list of faults already contains, with the component's own message."""

_LAST_FACTS = ("unit_number", "spot_fit")
"""Facts that a technician needs last."""
_MAX_LOST_SHOWN = 3
"""Maximum number of reasons for lost time that are named."""


def _state(report: StateReport) -> str:
    """State with its causes."""
    signal = str(report.signal).replace("_", " ")
    text = signal if report.signal is Signal.GOOD else signal.upper()
    text += f" for {duration((report.now_ns - report.since_ns) * 1e-9)}"
    if report.causes:
        text += f": {'; '.join(map(_cause, report.causes))}"
    return text


def state_steps(report: StateReport) -> list[str]:
    """Faults besides those of the measurement and the components, with their remedies."""
    return [
        f"{_cause(shown)}{_in_brackets(shown.cause.detail)}: {shown.cause.remedy}"
        for shown in report.causes
        if isinstance(shown.cause.kind, Condition) and shown.cause.kind not in _SHOWN_BY_COMPONENTS
    ]


def _cause(shown: ShownCause) -> str:
    just_now = "" if shown.is_active else " - just now"
    return f"{shown.cause.kind.brief}{_in_brackets(shown.cause.of)}{just_now}"


def _in_brackets(text: str | None) -> str:
    return f" ({text})" if text else ""


def _available(report: StateReport, whole: bool) -> str:
    """Availability; ``whole``: with the main reasons for lost time."""
    parts = []
    for name, span in report.availability.spans().items():
        if span.share is None:
            continue
        text = f"{_percent(span.share)} {span_text(name, span.observed_s)}"
        lost = list(span.lost_s.items())[:_MAX_LOST_SHOWN]
        if whole and lost:
            text += f" (lost: {', '.join(f'{reason} {duration(seconds)}' for reason, seconds in lost)})"
        parts.append(text)
    return "; ".join(dict.fromkeys(parts)) or "not known yet"


def _percent(share: float) -> str:
    """Percentage, rounded down, so that a missed promise does not look kept."""
    return f"{int(share * 1e4) / 100:.2f} %"


WIDTH = 79
"""Width of a line; some terminals would wrap a line of 80."""

NO_MEASUREMENT = "no measurement so far: wait, or type `health`"


def measurement_text(measurement: Measurement | None, age_s: float | None = None) -> str:
    """Describe a measurement with units, sigma and, if its age is known, sigma now; or why there is none."""
    if measurement is None:
        return NO_MEASUREMENT
    time = "time not known" if measurement.time is None else utc_text(measurement.time)
    lines = [f"measurement {measurement.sequence}, {time}, mean of {counted(measurement.frames, 'exposure')}"]
    if not measurement.valid:
        lines.append("  NOT VALID")
    lines += _value_lines(measurement, age_s)
    return "\n".join([*lines, *_reason_lines(measurement.status)])


def watch_head(quantities: Quantities) -> str:
    """Headings above the lines of ``watch_line``."""
    heads = (f"{f'{quantity.label} {ascii_unit(quantity)}':>11}" for quantity in quantities.main)
    return f"{'time (UTC)':<14}{''.join(heads)}"


def watch_line(measurement: Measurement | None) -> str:
    """One measurement in one line."""
    if measurement is None:
        return "no measurement so far"
    time = "-" if measurement.time is None else utc_text(measurement.time)[11:23]
    codes = " ".join(str(fault) for fault in measurement.status)
    if not measurement.valid:
        return f"{time:<14}NOT VALID: {codes}"[:WIDTH]
    numbers = (
        f"{measurement.values[quantity.key].value:11.{quantity.decimals - 1}f}"
        for quantity in measurement.quantities.main
    )
    return f"{time:<14}{''.join(numbers)} {codes}"[:WIDTH].rstrip()


def status_text(view: UnitView, *, whole: bool = False) -> str:
    """Describe the unit, whether it measures, remedies for what is wrong, and every component.

    ``whole``: with messages, counters and figures of the components.
    """
    measurement, components, report = view.measurement, view.components, view.state
    facts = {} if report is None else {"state": _state(report)}
    facts[MEASURING] = _measuring(measurement, components)
    if measurement is not None and measurement.valid:
        facts["sigma now"] = _uncertainty(measurement, view.age_s)
    if report is not None:
        facts["available"] = _available(report, whole)
    facts["zero"] = _zero(view.zero)
    known = view.facts.known
    facts |= {name: known[name] for name in sorted(known, key=_LAST_FACTS.__contains__)}
    width = max(map(len, facts)) + 2
    lines = [hanging(name, text, width) for name, text in facts.items()]
    lines += ["", *_what_to_do(measurement, components, [] if report is None else state_steps(report))]
    if components:
        lines += ["", *component_lines(components, whole=whole)]
    return "\n".join(lines)


def _zero(zero: ZeroState) -> str:
    if zero.measurement is None:
        return "not set since the start"
    time = zero.measurement.time
    return f"{'time not known' if time is None else utc_text(time)}, by {zero.by}"


def component_lines(components: Sequence[ComponentReport], *, whole: bool) -> list[str]:
    """A table of the components; ``whole``: with message, counters and figures of each."""
    if not components:
        return []
    column = min(max(len(component.name) for component in components), 40) + 2
    lines = [f"{'component':<{column}}{'state':<10}{'for':<11}".rstrip()]
    for component in components:
        lines.append(_component_line(component, column))
        if whole and (remarks := _remarks(component)):
            lines.append(hanging("", remarks, 4))
    return lines


def _uncertainty(measurement: Measurement, age_s: float | None) -> str:
    """Standard deviations of the values as statements about the current beam."""
    told = [
        f"{quantity.label} {sigma:.{quantity.decimals - 1}f} {ascii_unit(quantity)}"
        for quantity in measurement.quantities.main
        if (sigma := _sigma_now(measurement, quantity, age_s)) is not None
    ]
    return ", ".join(told) or "not known: the motion of the beam has not been observed yet"


def _sigma_now(measurement: Measurement, quantity: Quantity, age_s: float | None) -> float | None:
    return None if age_s is None else measurement.sigma_at(quantity.key, age_s)


def _value_lines(measurement: Measurement, age_s: float | None) -> list[str]:
    """One line per quantity, followed by its value in another unit.

    For an invalid measurement, only values of other sensors.
    """
    lines = {}
    of_unit = measurement.quantities.of_unit
    for quantity in of_unit if measurement.valid else (each for each in of_unit if each.is_from_sensor):
        value, decimals = measurement.known(quantity.key), quantity.decimals - 1
        if value is None:
            lines[quantity.key] = f"  {quantity.label:<10}not available"
        elif quantity.is_also:
            lines[quantity.is_also] += f"  ={value.value:9.{decimals}f} {ascii_unit(quantity)}"
        else:
            sigma = "" if value.sigma is None else f"+/- {value.sigma:.{decimals}f}"
            if (now := _sigma_now(measurement, quantity, age_s)) is not None:
                sigma += f", now {now:.{decimals}f}"
            line = f"  {quantity.label:<7}{value.value:10.{decimals}f} {ascii_unit(quantity):<4}{sigma}"
            lines[quantity.key] = line.rstrip()
    return list(lines.values())


def ascii_unit(quantity: Quantity) -> str:
    """The unit of a quantity in ASCII."""
    return shown_in("ascii", quantity.unit)


def _reason_lines(status: Sequence[Fault]) -> list[str]:
    lines = []
    for fault in status:
        means, remedy = advice(fault, status)
        lines.append(
            hanging("", f"{_of_targets([fault.target] if fault.target else [])}{means}: {remedy}", 2)
        )
        if fault.detail:
            lines.append(hanging("", fault.detail, 4))
    return lines


def _measuring(measurement: Measurement | None, components: Sequence[ComponentReport]) -> str:
    if measurement is None:
        return "NO, no measurement so far"
    status = measurement.status
    targets: dict[str, list[str]] = {}
    for fault in status:
        means = advice(fault, status, components).means
        targets.setdefault(means, []).extend(filter(None, [fault.target]))
    reasons = "; ".join(f"{_of_targets(of)}{means}" for means, of in targets.items())
    if measurement.valid:
        return f"yes, but {reasons}" if reasons else "yes"
    return f"NO: {reasons}"


def _component_line(component: ComponentReport, column: int) -> str:
    state = component.state.upper() if component.state is State.FAILED else str(component.state)
    return f"{component.name:<{column - 1}} {state:<10}{duration(component.for_s)}"


def _remarks(component: ComponentReport) -> str:
    numbers = {**component.figures, **component.counters}
    told = [f"{name} {number}" for name, number in numbers.items() if number is not None]
    return "; ".join(filter(None, [component.message, ", ".join(told)]))


def _what_to_do(
    measurement: Measurement | None, components: Sequence[ComponentReport], further: Sequence[str]
) -> list[str]:
    status = measurement.status if measurement else ()
    targets: dict[tuple[str, str], list[str]] = {}
    for fault in status:
        means, remedy = advice(fault, status, components)
        seen = fault.detail.removeprefix(means).lstrip(", ")
        told = (f"{means} ({seen})" if seen else means), remedy
        targets.setdefault(told, []).extend(filter(None, [fault.target]))
    steps = [f"{_of_targets(of)}{told}: {remedy}" for (told, remedy), of in targets.items()]
    steps += [*component_steps(components, status), *further]
    if not steps:
        return ["nothing is wrong" if measurement else NO_MEASUREMENT]
    return ["causes and remedies:", *(hanging("  -", step, 4) for step in steps)]


def _of_targets(targets: Sequence[str]) -> str:
    """Targets that something concerns, as a prefix; empty: the whole unit."""
    return f"{' and '.join(targets)} target{'s' * (len(targets) > 1)}: " if targets else ""


def hanging(name: str, text: str, indent: int) -> str:
    """Text next to a name, its further lines below its first."""
    return fill(
        shown_in("ascii", text),
        WIDTH,
        initial_indent=f"{name:<{indent}}",
        subsequent_indent=" " * indent,
        break_on_hyphens=False,
    )
