"""Measurement and health in the words of a technician, 80 columns of ASCII, lines ended by LF."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

from altd.publish.serial.advice import advice, component_steps
from altd.records import Fault, Measurement, Quantities, Quantity, utc_text
from altd.status.health import MEASURING, Component, Health, State, duration

WIDTH = 79
"""A line of 80 would make some terminals wrap."""

_NO_MEASUREMENT = "no measurement so far: wait some seconds, then see `status`"


def measurement_text(measurement: Measurement | None) -> str:
    """One measurement with units and sigma, or why there is none."""
    if measurement is None:
        return _NO_MEASUREMENT
    time = "time not known" if measurement.time is None else utc_text(measurement.time)
    lines = [f"measurement {measurement.sequence}, {time}, mean of {measurement.frames} exposures"]
    lines += _value_lines(measurement) if measurement.valid else ["  NOT VALID"]
    return "\n".join([*lines, *_reason_lines(measurement.status)])


def watch_head(quantities: Quantities) -> str:
    """The headings over the lines of ``watch_line``."""
    heads = (f"{f'{quantity.label} {_unit(quantity)}':>11}" for quantity in quantities.main)
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


def status_text(measurement: Measurement | None, health: Health, *, whole: bool = False) -> str:
    """The unit, whether it measures, what to do about what is wrong, and every component.

    ``whole``: with all that the components say, count and measure of themselves.
    """
    components = list(health)
    facts = {**health.facts, MEASURING: _measuring(measurement, components)}
    width = max(map(len, facts)) + 2
    lines = [_hanging(name, text, width) for name, text in facts.items()]
    lines += ["", *_what_to_do(measurement, components)]
    if components:
        column = min(max(len(component.name) for component in components), 40) + 2
        lines += ["", f"{'component':<{column}}{'state':<10}{'for':<11}".rstrip()]
        for component in components:
            lines.append(_component_line(component, column))
            if whole and (remarks := _remarks(component)):
                lines.append(_hanging("", remarks, 4))
    return "\n".join(lines)


def _value_lines(measurement: Measurement) -> list[str]:
    """A line a quantity, with what it is in another unit behind it."""
    lines = {}
    for quantity in measurement.quantities.of_unit:
        value, decimals = measurement.values.get(quantity.key), quantity.decimals - 1
        if value is None:
            lines[quantity.key] = f"  {quantity.label:<10}not available"
        elif quantity.is_also:
            lines[quantity.is_also] += f"  ={value.value:9.{decimals}f} {_unit(quantity)}"
        else:
            sigma = "" if value.sigma is None else f"+/- {value.sigma:.{decimals}f}"
            line = f"  {quantity.label:<7}{value.value:10.{decimals}f} {_unit(quantity):<4}{sigma}"
            lines[quantity.key] = line.rstrip()
    return list(lines.values())


def _unit(quantity: Quantity) -> str:
    """In ASCII."""
    return quantity.unit.replace("°", "deg")


def _reason_lines(status: Sequence[Fault]) -> list[str]:
    lines = []
    for fault in status:
        means, remedy = advice(fault, status)
        lines.append(
            _hanging("", f"{_of_targets([fault.target] if fault.target else [])}{means}: {remedy}", 2)
        )
        if fault.detail:
            lines.append(_hanging("", fault.detail, 4))
    return lines


def _measuring(measurement: Measurement | None, components: Sequence[Component]) -> str:
    if measurement is None:
        return "NO, nothing was measured so far"
    status = measurement.status
    targets: dict[str, list[str]] = {}
    for fault in status:
        means = advice(fault, status, components).means
        targets.setdefault(means, []).extend(filter(None, [fault.target]))
    reasons = "; ".join(f"{_of_targets(of)}{means}" for means, of in targets.items())
    if measurement.valid:
        return f"yes, but {reasons}" if reasons else "yes"
    return f"NO: {reasons}"


def _component_line(component: Component, column: int) -> str:
    seconds = (component.clock.monotonic_ns() - component.since_ns) * 1e-9
    state = component.state.upper() if component.state is State.FAILED else str(component.state)
    return f"{component.name:<{column - 1}} {state:<10}{duration(seconds)}"


def _remarks(component: Component) -> str:
    numbers = {**component.figures, **component.counters}
    told = [f"{name} {number}" for name, number in numbers.items() if number is not None]
    return "; ".join(filter(None, [component.message, ", ".join(told)]))


def _what_to_do(measurement: Measurement | None, components: Sequence[Component]) -> list[str]:
    status = measurement.status if measurement else ()
    targets: dict[tuple[str, str], list[str]] = {}
    for fault in status:
        means, remedy = advice(fault, status, components)
        seen = fault.detail.removeprefix(means).lstrip(", ")
        told = (f"{means} ({seen})" if seen else means), remedy
        targets.setdefault(told, []).extend(filter(None, [fault.target]))
    steps = [f"{_of_targets(of)}{told}: {remedy}" for (told, remedy), of in targets.items()]
    steps += component_steps(components, status)
    if not steps:
        return ["nothing is wrong" if measurement else _NO_MEASUREMENT]
    return ["what is wrong, and what to do:", *(_hanging("  -", step, 4) for step in steps)]


def _of_targets(targets: Sequence[str]) -> str:
    """The targets that something concerns, before what it is; empty: the whole unit."""
    return f"{' and '.join(targets)} target{'s' * (len(targets) > 1)}: " if targets else ""


def _hanging(name: str, text: str, indent: int) -> str:
    """The text beside a name, its further lines below its first."""
    return fill(
        _ascii(text),
        WIDTH,
        initial_indent=f"{name:<{indent}}",
        subsequent_indent=" " * indent,
        break_on_hyphens=False,
    )


def _ascii(text: str) -> str:
    """What any terminal can show."""
    return text.encode("ascii", "replace").decode("ascii")
