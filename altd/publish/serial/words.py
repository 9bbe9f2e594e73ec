"""Measurement and health in the words of a technician, 80 columns of ASCII, lines ended by LF."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import fill

from altd.measurement_json import utc_text
from altd.records import Beam, Fault, Measurement, Reason
from altd.service.health import Component, Health, State, duration

WIDTH = 79
"""A line of 80 would make some terminals wrap."""

ADVICE: dict[Reason, tuple[str, str]] = {
    Reason.SPOT_MISSING: ("no laser spot", "switch the laser on and check that its beam enters the window"),
    Reason.AMBIGUOUS: ("more than one spot", "look for reflections and other lasers or lamps in the window"),
    Reason.SATURATED: ("the spot is overexposed", "shorten the exposure or take power off the laser"),
    Reason.CUT_BY_EDGE: ("the spot is cut by the edge of the image", "bring the beam nearer to the middle"),
    Reason.WRONG_SIZE: ("the spot has a wrong size", "clean the window and check the focus of the laser"),
    Reason.WRONG_SHAPE: ("the spot has a wrong shape", "clean the window and look for reflections"),
    Reason.DISTORTED: ("the spot is distorted", "clean the window, look for reflections and other light"),
    Reason.CAMERA_SILENT: ("the camera delivers nothing", "check the camera's cable and supply"),
    Reason.EXPOSURE_CHANGING: ("the exposure is being set anew", "wait a second"),
    Reason.FRAME_REPEATED: ("the camera repeats one picture", "unplug the camera and plug it in again"),
    Reason.WRONG_CAMERA: ("not the calibrated camera", "check the cameras' cables and the calibration file"),
    Reason.IMPLAUSIBLE: ("two maps of the target contradict each other", "load or make the calibration anew"),
    Reason.OUT_OF_STEP: ("the cameras are out of step", "check the trigger of the cameras"),
    Reason.OUT_OF_RANGE: ("outside the calibrated area", "bring the beam nearer to the middle"),
    Reason.UNSTEADY: ("the spot moves too much", "wait until the machine stands, look for vibration"),
    Reason.WARMING_UP: ("too few exposures so far", "wait some seconds"),
    Reason.STALE: ("nothing new is measured", "look in `status` for the component that has stopped"),
    Reason.CHECK_FAILED: ("numbers that cannot be", "restart the unit, check its config and calibration"),
    Reason.EXPOSURES_LOST: ("exposures were lost", "if it stays, check the cameras' cables"),
    Reason.PLAYBACK: ("a recording is played, this is NOT LIVE", "do not steer by it"),
    Reason.SIMULATED: ("frames or calibration are simulated, this is NOT LIVE", "do not steer by it"),
}
"""What a reason means and what to do about it."""

_NO_MEASUREMENT = "no measurement so far: wait some seconds, then see `status`"


def measurement_text(measurement: Measurement | None) -> str:
    """One measurement with units and sigma, or why there is none."""
    if measurement is None:
        return _NO_MEASUREMENT
    time = "time not known" if measurement.time is None else utc_text(measurement.time)
    lines = [f"measurement {measurement.sequence}, {time}, mean of {measurement.frames} exposures"]
    if measurement.beam is not None:
        lines += _beam_lines(measurement.beam)
        roll = measurement.roll_deg
        lines.append("  roll      not available" if roll is None else f"  roll   {roll:10.4f} deg")
    else:
        lines.append("  NOT VALID")
    return "\n".join([*lines, *_reason_lines(measurement.status)])


def watch_head() -> str:
    """The headings over the lines of ``watch_line``."""
    return f"{'time (UTC)':<14}{'x mm':>11}{'y mm':>11}{'yaw deg':>11}{'pitch deg':>11}"


def watch_line(measurement: Measurement | None) -> str:
    """One measurement in one line."""
    if measurement is None:
        return "no measurement so far"
    time = "-" if measurement.time is None else utc_text(measurement.time)[11:23]
    beam = measurement.beam
    codes = " ".join(str(fault) for fault in measurement.status)
    if beam is None:
        return f"{time:<14}NOT VALID: {codes}"[:WIDTH]
    numbers = f"{beam.x_mm:11.3f}{beam.y_mm:11.3f}{beam.yaw_deg:11.4f}{beam.pitch_deg:11.4f}"
    return f"{time:<14}{numbers} {codes}"[:WIDTH].rstrip()


def status_text(measurement: Measurement | None, health: Health) -> str:
    """The unit, whether it measures, every component, and what to do about what is wrong."""
    facts = {**health.facts, "measuring": _measuring(measurement)}
    width = max(map(len, facts)) + 2
    lines = [_hanging(name, text, width) for name, text in facts.items()]
    components = list(health)
    if components:
        column = min(max(len(component.name) for component in components), 40) + 2
        lines += ["", f"{'component':<{column}}{'state':<10}{'for':<11}".rstrip()]
        lines += [_component_line(component, column) for component in components]
    lines += ["", *_what_to_do(measurement, components)]
    return "\n".join(lines)


def _beam_lines(beam: Beam) -> list[str]:
    lines = [
        f"  {name:<7}{value:10.3f} mm  +/- {sigma:.3f}"
        for name, value, sigma in (("x", beam.x_mm, beam.sigma_x_mm), ("y", beam.y_mm, beam.sigma_y_mm))
    ]
    angles = (
        ("yaw", beam.yaw_deg, beam.sigma_yaw_deg, beam.yaw_mm_per_m),
        ("pitch", beam.pitch_deg, beam.sigma_pitch_deg, beam.pitch_mm_per_m),
    )
    return lines + [
        f"  {name:<7}{angle:10.4f} deg +/- {sigma:.4f}  ={slope:9.3f} mm/m"
        for name, angle, sigma, slope in angles
    ]


def _reason_lines(status: Iterable[Fault]) -> list[str]:
    lines = []
    for fault in status:
        means, remedy = ADVICE[fault.reason]
        lines.append(_hanging("", f"{_named(fault, means)}: {remedy}", 2))
        if fault.detail:
            lines.append(_hanging("", _ascii(fault.detail), 4))
    return lines


def _named(fault: Fault, means: str) -> str:
    return f"{fault.target} target: {means}" if fault.target else means


def _measuring(measurement: Measurement | None) -> str:
    if measurement is None:
        return "NO, nothing was measured so far"
    reasons = "; ".join(_named(fault, ADVICE[fault.reason][0]) for fault in measurement.status)
    if measurement.valid:
        return f"yes, but {reasons}" if reasons else "yes"
    return f"NO: {reasons}"


def _component_line(component: Component, column: int) -> str:
    seconds = (component.clock.monotonic_ns() - component.since_ns) * 1e-9
    state = component.state.upper() if component.state is State.FAILED else str(component.state)
    head = f"{component.name:<{column - 1}} {state:<10}{duration(seconds):<11}"
    numbers = {**component.figures, **component.counters}
    counters = ", ".join(f"{name} {number}" for name, number in numbers.items() if number is not None)
    remarks = "; ".join(filter(None, [component.message, counters]))
    return "\n".join([head.rstrip(), *([_hanging("", remarks, 4)] if remarks else [])])


def _what_to_do(measurement: Measurement | None, components: Iterable[Component]) -> list[str]:
    steps = [
        f"{_named(fault, means)}: {remedy}"
        for fault in (measurement.status if measurement else ())
        for means, remedy in [ADVICE[fault.reason]]
    ]
    steps += [
        f"{component.name} {component.state}: {component.message or 'no more is known'}"
        for component in components
        if component.state in (State.FAILED, State.DEGRADED)
    ]
    if not steps:
        return ["nothing is wrong" if measurement else _NO_MEASUREMENT]
    return ["what is wrong, and what to do:", *(_hanging("  -", step, 4) for step in steps)]


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
