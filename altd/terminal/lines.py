"""Lines of text for a person, and the text of ``altd status``: one unit on one screen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from textwrap import wrap

from altd.reasons import NOT_FROM_CAMERAS, Reason
from altd.records import Origin, counted
from altd.selfcheck.records import DriftLimits
from altd.status.availability import span_text
from altd.status.cross_check import CrossCheckedMeasurement
from altd.status.health import duration
from altd.status.models import Cause
from altd.terminal.documents import (
    CalibrationDocument,
    SelfCheckDocument,
    Shown,
    ShownBeam,
    StatusDocument,
)

WIDTH = 79
"""Width of a line; some terminals would wrap a line of 80."""


def state_text(signal: str) -> str:
    """Text of a state: ``good``, ``MAINTENANCE REQUIRED``."""
    text = signal.replace("_", " ")
    return text if signal == "good" else text.upper()


def verdict_text(reading: ShownBeam) -> str:
    """Text about the usability of the numbers: ``VALID``, ``SIMULATED``, ``NOT VALID``."""
    if not reading.valid:
        return "NOT VALID"
    origins = [code.upper() for code in reading.status if code in NOT_FROM_CAMERAS]
    return ", ".join(origins) or "VALID"


def cause_text(cause: Cause) -> str:
    """A cause with its remedy, in the wording of the table of causes."""
    of = f" ({cause.of})" if cause.of else ""
    just_now = "" if cause.active else ", just now"
    detail = f" [{cause.detail}]" if cause.detail else ""
    return f"{cause.brief}{of}{just_now}{detail}: {cause.remedy}"


def number_text(number: Shown, valid: bool, width: int = WIDTH) -> str:
    """A quantity in one line; its sigmas and its other unit if each fits completely into ``width``."""
    if number.value is None:
        return f"{number.label:<7}{'not available' if valid else '-':>13}"
    text = f"{number.label:<7}{number.value:>10.{number.decimals}f} {number.unit:<4}"
    sigma = "" if number.sigma is None else f"+/- {number.sigma:.{number.decimals}f}"
    now = "" if number.sigma_now is None else f"now {number.sigma_now:.{number.decimals}f}"
    parts = [f"{sigma:<13}", f"{now:<12}"]
    if number.also is not None and number.also[0] is not None:
        value, unit, decimals = number.also
        parts.append(f"= {value:>9.{decimals}f} {unit}")
    for part in parts:
        if len((text + part).rstrip()) > width:
            break
        text += part
    return text.rstrip()


def availability_text(status: StatusDocument) -> str:
    """Share of time in which the unit measured, for each span; rounded down."""
    shares = [
        f"{int(span.share * 1e4) / 100:.2f} % {span_text(name, span.observed_s)}"
        for name, span in status.availability
        if span.share is not None
    ]
    return "; ".join(dict.fromkeys(shares)) or "not known yet"


def self_check_text(check: SelfCheckDocument) -> str:
    """The last self-check in a sentence."""
    reasons = "; ".join(check.reasons)
    if check.verdict is None:
        return f"none: {reasons}" if reasons else "none"
    text = f"{check.verdict}: {reasons}" if reasons else check.verdict
    return f"{check.time}: {text}" if check.time else text


def hanging(head: str, text: str, width: int, indent: int) -> list[str]:
    """The text after ``head``, its further lines below its first one."""
    return wrap(
        text,
        width,
        initial_indent=f"{head:<{indent}}",
        subsequent_indent=" " * indent,
        break_on_hyphens=False,
    ) or [head]


_INDENT = 13
_MAX_NAME = 40
_HEALTHY = ("good", "maintenance_required")
"""States in which the numbers may be used and the unit's own table requires no action now."""


def is_healthy(reading: ShownBeam | None, status: StatusDocument) -> bool:
    """Whether the unit measures, and its state is good or requires no more than maintenance."""
    return reading is not None and reading.valid and status.state.signal in _HEALTHY


def status_text(
    reading: ShownBeam | None,
    status: StatusDocument,
    check: SelfCheckDocument,
    calibration: CalibrationDocument,
) -> str:
    """The unit, state, causes and remedies, numbers, availability, self-check, calibration, components."""
    parts = _unit(status), _measured(reading), _further(status, check, calibration), _components(status)
    return "\n".join(line for part in parts for line in part)


def of_desk(status: StatusDocument) -> str:
    """Return the words after the serial number of a unit on a desk; empty: a machine's unit."""
    return " on a desk" if status.kind == "desk" else ""


def _unit(status: StatusDocument) -> Iterator[str]:
    unit = f"{status.serial}{of_desk(status)}, altd {status.version}, calibration {status.calibration}"
    yield from hanging("unit", unit, WIDTH, _INDENT)
    state = status.state
    yield from hanging("state", f"{state_text(state.signal)} for {duration(state.for_s)}", WIDTH, _INDENT)
    for cause in state.causes:
        yield from hanging("  -", cause_text(cause), WIDTH, 4)


def _measured(reading: ShownBeam | None) -> Iterator[str]:
    yield ""
    if reading is None:
        yield from hanging("measuring", "NO: nothing has been measured yet", WIDTH, _INDENT)
        return
    age = "of unknown age" if reading.age_s is None else f"{reading.age_s:.2f} s old"
    said = f"{age}, mean of {counted(reading.frames, 'exposure')}, number {reading.sequence}"
    text = ", ".join(filter(None, [verdict_text(reading), said, reading.time]))
    yield from hanging("measuring", text, WIDTH, _INDENT)
    yield from (f"  {number_text(number, reading.valid)}" for number in reading.numbers)
    if reading.valid and reading.cross_check is not None:
        yield from _cross_check(reading.cross_check)


def _cross_check(by: CrossCheckedMeasurement) -> Iterator[str]:
    yield ""
    head = "cross-check"
    for name, target in by.targets.items():
        place = f"spot at u {_fixed(target.u_px, 2)} v {_fixed(target.v_px, 2)} px"
        second = f"x {_fixed(target.x_mm, 3)} y {_fixed(target.y_mm, 3)} mm by the second map"
        yield from hanging(head, f"{name}: {place}, {second}", WIDTH, _INDENT)
        head = ""
    angles = f"yaw {_fixed(by.yaw_deg, 4)} pitch {_fixed(by.pitch_deg, 4)} deg by the second maps"
    yield from hanging(head, angles, WIDTH, _INDENT)


def _fixed(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"


def _further(
    status: StatusDocument, check: SelfCheckDocument, calibration: CalibrationDocument
) -> Iterator[str]:
    yield ""
    yield from hanging("available", availability_text(status), WIDTH, _INDENT)
    hours = status.operating_hours
    yield from hanging("operated", "not known" if hours is None else f"{hours:.1f} h", WIDTH, _INDENT)
    yield from hanging("self-check", self_check_text(check), WIDTH, _INDENT)
    head = "calibration"
    for target in calibration.targets:
        figures = (
            (target.left_out_px, "rms", "px"),
            (target.residuals.max_mm, "largest residual", "mm"),
        )
        known = [f"{what} {value:.3f} {unit}" for value, what, unit in figures if value is not None]
        text = ", ".join([*known, "without flat" if target.flat is None else "with flat"])
        yield from hanging(head, f"{target.name}: {text}", WIDTH, _INDENT)
        head = ""


def _components(status: StatusDocument) -> Iterator[str]:
    """Rows for the components that are not ok, and the names of the others."""
    names = [name for name, component in status.components.items() if component.state != "ok"]
    column = min(max(map(len, ["component", *names])), _MAX_NAME) + 2
    yield ""
    if names:
        yield f"{'component':<{column}}{'state':<10}for"
    for name in names:
        component = status.components[name]
        yield f"{name[:_MAX_NAME]:<{column}}{component.state[:9]:<10}{duration(component.for_s)}"
        if component.state != "starting" and component.message:
            yield from hanging("", component.message, WIDTH, 4)
    yield from hanging(
        "ok", ", ".join(name for name in status.components if name not in names), WIDTH, _INDENT
    )


_ACTIONS = {
    "good": "nothing to do",
    "suspect": Reason.GEOMETRY_SUSPECT.remedy,
    "bad": Reason.GEOMETRY_DRIFT.remedy,
    "unknown": "look at the frame LEDs and their wiring, clean the windows, move the beam",
}


def self_check_table(check: SelfCheckDocument) -> list[str]:
    """Rows for the LEDs of each target and for each part of the verdict; then the action and the reasons."""
    rows = [("check", "verdict", "good if", "bad if", "value, +/- 1 sigma")]
    for name, target in check.targets.items():
        unused = Counter(state.replace("_", " ") for state in target.leds if state != "used")
        value = "".join(
            [f"{target.leds_found} of {target.leds_expected} used"]
            + [f", {number} {state}" for state, number in unused.items()]
        )
        verdict = "good" if target.leds_found >= DriftLimits().min_leds else "unknown"
        rows.append((f"LEDs {name}", verdict, f">= {DriftLimits().min_leds}", "", value))
    for part in check.parts:
        known = part.error is not None and part.sigma is not None
        value = f"{part.error:.4f} +/- {part.sigma:.4f} {part.unit}" if known else "not known"
        limits = f"<= {part.suspect:.3g}", f"> {part.bad:.3g}"
        rows.append((f"drift {part.of}", part.verdict, *limits, value))
    column = min(max(len(row[0]) for row in rows), _MAX_NAME)
    lines = []
    if len(rows) > 1:
        for name, verdict, good, bad, value in rows:
            head = f"{name[:column]:<{column}}  {verdict[:8]:<9}{good[:9]:<10}{bad[:8]:<9}"
            lines += hanging(head, value, WIDTH, len(head))
        lines.append("")
    verdict = check.verdict or "none"
    action = _ACTIONS.get(verdict, "")
    lines += hanging("verdict", f"{verdict if verdict == 'good' else verdict.upper()}: {action}", WIDTH, 9)
    details = [f"{name}: {target.detail}" for name, target in check.targets.items() if target.detail]
    remarks = [*check.reasons, *(detail for detail in details if detail not in check.reasons), *check.notes]
    lines += [line for remark in remarks for line in hanging("  -", remark, WIDTH, 4)]
    if check.origin == Origin.SIMULATED:
        lines.append("judged from SIMULATED frames")
    return lines
