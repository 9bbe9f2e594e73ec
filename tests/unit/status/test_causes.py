"""Every cause of a state is reached, and brings the signal of its table."""

from collections.abc import Callable
from typing import cast

import pytest

from altd.publish.serial.words import status_text
from altd.reasons import Reason, Scope
from altd.records import Fault, FaultCause
from altd.status.cause import MAINTENANCE_DELAY_S, Cause, StateReport
from altd.status.causes import MAX_START_S, START_S
from altd.status.conditions import Condition
from altd.status.health import CameraTrouble, State

from .clocked_unit import STALE_AFTER_S, Unit, kinds


def with_component(
    name: str, state: State, trouble: CameraTrouble | None = None
) -> Callable[[Unit], StateReport]:
    def scenario(unit: Unit) -> StateReport:
        unit.health.component(name).set_state(state, "its own words", trouble)
        return unit.measure(for_s=MAINTENANCE_DELAY_S)

    return scenario


def with_watch(condition: Condition) -> Callable[[Unit], StateReport]:
    """The watches that find these out have tests of their own; here: that what they say is shown."""

    def scenario(unit: Unit) -> StateReport:
        unit.watched = [Cause(condition, "front", "seen")]
        return unit.measure(for_s=MAINTENANCE_DELAY_S)

    return scenario


def measured_with(reason: Reason) -> Callable[[Unit], StateReport]:
    def scenario(unit: Unit) -> StateReport:
        target = "front" if reason.scope is Scope.TARGET else None
        return unit.measure(Fault(reason, target, "seen"), for_s=MAINTENANCE_DELAY_S)

    return scenario


def nothing_follows(unit: Unit) -> StateReport:
    unit.measure()
    unit.clock.now_ns += round((STALE_AFTER_S + 0.1) * 1e9)
    return unit.state.read()


def just_started(unit: Unit) -> StateReport:
    return Unit(running_s=START_S - 0.1).state.read()


def a_reason_of_no_table(unit: Unit) -> StateReport:
    unit.publish(Fault(cast("Reason", "gremlins")), valid=False)
    return unit.state.read()


def a_component_that_died(unit: Unit) -> StateReport:
    component = unit.health.component("camera rear")
    component.set_state(State.OK)
    component.expect(3.0)
    return unit.measure(for_s=3.5)


def a_component_that_does_not_come_up(unit: Unit) -> StateReport:
    unit.health.component("serial /dev/ttyS1")
    return unit.measure(for_s=MAX_START_S + MAINTENANCE_DELAY_S + 1)


FAILURE, CHECK, OFF_SPEC, MAINTENANCE = (
    "failure", "check_function", "out_of_specification", "maintenance_required",
)  # fmt: skip

REACHED: dict[str, tuple[str, Callable[[Unit], StateReport]]] = {
    "spot_missing": (OFF_SPEC, measured_with(Reason.SPOT_MISSING)),
    "ambiguous": (OFF_SPEC, measured_with(Reason.AMBIGUOUS)),
    "saturated": (OFF_SPEC, measured_with(Reason.SATURATED)),
    "cut_by_edge": (OFF_SPEC, measured_with(Reason.CUT_BY_EDGE)),
    "wrong_size": (OFF_SPEC, measured_with(Reason.WRONG_SIZE)),
    "wrong_shape": (OFF_SPEC, measured_with(Reason.WRONG_SHAPE)),
    "distorted": (OFF_SPEC, measured_with(Reason.DISTORTED)),
    "camera_silent": (FAILURE, measured_with(Reason.CAMERA_SILENT)),
    "exposure_changing": (CHECK, measured_with(Reason.EXPOSURE_CHANGING)),
    "frame_repeated": (FAILURE, measured_with(Reason.FRAME_REPEATED)),
    "wrong_camera": (FAILURE, measured_with(Reason.WRONG_CAMERA)),
    "implausible": (FAILURE, measured_with(Reason.IMPLAUSIBLE)),
    "out_of_step": (FAILURE, measured_with(Reason.OUT_OF_STEP)),
    "out_of_range": (OFF_SPEC, measured_with(Reason.OUT_OF_RANGE)),
    "unsteady": (OFF_SPEC, measured_with(Reason.UNSTEADY)),
    "warming_up": (CHECK, measured_with(Reason.WARMING_UP)),
    "stale": (FAILURE, nothing_follows),
    "check_failed": (FAILURE, measured_with(Reason.CHECK_FAILED)),
    "geometry_drift": (FAILURE, measured_with(Reason.GEOMETRY_DRIFT)),
    "geometry_unverified": (FAILURE, measured_with(Reason.GEOMETRY_UNVERIFIED)),
    "self_checking": (CHECK, measured_with(Reason.SELF_CHECKING)),
    "geometry_suspect": (MAINTENANCE, measured_with(Reason.GEOMETRY_SUSPECT)),
    "geometry_unknown": (MAINTENANCE, measured_with(Reason.GEOMETRY_UNKNOWN)),
    "compensated": (MAINTENANCE, measured_with(Reason.COMPENSATED)),
    "exposures_lost": (MAINTENANCE, measured_with(Reason.EXPOSURES_LOST)),
    "playback": (CHECK, measured_with(Reason.PLAYBACK)),
    "simulated": (CHECK, measured_with(Reason.SIMULATED)),
    "not_live": (CHECK, measured_with(Reason.SIMULATED)),
    "rehearsal": (CHECK, measured_with(Reason.REHEARSAL)),
    "roll_missing": (MAINTENANCE, measured_with(Reason.ROLL_MISSING)),
    "pitch_diverges": (MAINTENANCE, measured_with(Reason.PITCH_DIVERGES)),
    "leds_missing": (OFF_SPEC, measured_with(Reason.LEDS_MISSING)),
    "leds_misfit": (OFF_SPEC, measured_with(Reason.LEDS_MISFIT)),
    "stuck_clear": (FAILURE, measured_with(Reason.STUCK_CLEAR)),
    "slow": (FAILURE, measured_with(Reason.SLOW)),
    "not_confirmed": (FAILURE, measured_with(Reason.NOT_CONFIRMED)),
    "cameras_swapped": (FAILURE, measured_with(Reason.CAMERAS_SWAPPED)),
    "beam_lost": (OFF_SPEC, measured_with(Reason.BEAM_LOST)),
    "stuck_opaque": (FAILURE, measured_with(Reason.STUCK_OPAQUE)),
    "switch_unseen": (MAINTENANCE, measured_with(Reason.SWITCH_UNSEEN)),
    "beam_lost_behind": (OFF_SPEC, measured_with(Reason.BEAM_LOST_BEHIND)),
    "stable_moved": (OFF_SPEC, measured_with(Reason.STABLE_MOVED)),
    "stable_targets_disagree": (OFF_SPEC, measured_with(Reason.STABLE_DISAGREE)),
    "no_baseline": (MAINTENANCE, measured_with(Reason.NO_BASELINE)),
    "baseline_incomplete": (CHECK, measured_with(Reason.BASELINE_INCOMPLETE)),
    "beam_angle_unknown": (MAINTENANCE, measured_with(Reason.BEAM_ANGLE_UNKNOWN)),
    "beam_drift_unknown": (MAINTENANCE, measured_with(Reason.BEAM_DRIFT_UNKNOWN)),
    "beam_not_closed": (CHECK, measured_with(Reason.BEAM_NOT_CLOSED)),
    "alarm_displacement": (OFF_SPEC, measured_with(Reason.ALARM_DISPLACEMENT)),
    "alarm_rate": (OFF_SPEC, measured_with(Reason.ALARM_RATE)),
    "starting": (CHECK, just_started),
    "nothing_measured": (FAILURE, lambda unit: unit.state.read()),
    "unknown_reason": (FAILURE, a_reason_of_no_table),
    "camera_failed": (FAILURE, with_component("camera front", State.FAILED)),
    "camera_degraded": (MAINTENANCE, with_component("camera front", State.DEGRADED)),
    "camera_automatic": (
        MAINTENANCE,
        with_component("camera front", State.DEGRADED, CameraTrouble.AUTOMATIC),
    ),
    "recording_ended": (CHECK, with_component("camera front", State.ENDED)),
    "face_failed": (MAINTENANCE, with_component("modbus_tcp 0.0.0.0:502", State.FAILED)),
    "lamps_failed": (MAINTENANCE, with_component("lamps", State.FAILED)),
    "indicators_failed": (MAINTENANCE, with_component("indicators", State.FAILED)),
    "sensor_failed": (MAINTENANCE, with_component("inclinometer", State.FAILED)),
    "component_failed": (FAILURE, with_component("something new", State.FAILED)),
    "component_degraded": (MAINTENANCE, with_component("something new", State.DEGRADED)),
    "component_silent": (FAILURE, a_component_that_died),
    "not_started": (MAINTENANCE, a_component_that_does_not_come_up),
    "too_cold": (OFF_SPEC, with_watch(Condition.TOO_COLD)),
    "too_hot": (OFF_SPEC, with_watch(Condition.TOO_HOT)),
    "temperature_unknown": (MAINTENANCE, with_component("temperature housing", State.FAILED)),
    "laser_weak": (MAINTENANCE, with_watch(Condition.LASER_WEAK)),
    "residuals_rising": (MAINTENANCE, with_watch(Condition.RESIDUALS_RISING)),
    "dusty": (MAINTENANCE, with_watch(Condition.DUSTY)),
    "calibration_due": (MAINTENANCE, with_watch(Condition.CALIBRATION_DUE)),
    "computer_busy": (MAINTENANCE, with_component("computer", State.DEGRADED)),
    "clock_wrong": (MAINTENANCE, with_watch(Condition.CLOCK_WRONG)),
}
"""Each cause by its code: the signal that it brings, and what brings it about."""


def test_the_table_of_causes_is_complete_and_no_code_has_two_meanings() -> None:
    codes = [str(kind) for table in (Reason, Condition) for kind in table]
    assert sorted(REACHED) == sorted(codes)
    assert len(codes) == len(set(codes))
    assert len(codes) >= 30


@pytest.mark.parametrize("code", REACHED)
def test_is_reached(code: str) -> None:
    signal, scenario = REACHED[code]
    unit = Unit()
    report = scenario(unit)
    assert code in kinds(report)
    assert str(report.signal) == signal
    found = next(shown for shown in report.causes if shown.cause.kind == code)
    assert (found.signal, found.is_active) == (signal, True)
    assert found.cause.kind.brief
    assert found.cause.kind.remedy


@pytest.mark.parametrize("reason", [Reason.OUT_OF_STEP, Reason.EXPOSURES_LOST, Reason.CAMERA_SILENT])
def test_while_the_computer_is_busy_no_cable_and_no_trigger_is_suspected_first(reason: Reason) -> None:
    unit = Unit()
    computer = unit.health.component("computer")

    def advice() -> set[str]:
        report = unit.measure(Fault(reason, "front"), for_s=MAINTENANCE_DELAY_S)
        console = status_text(unit.published.view()).replace("\n    ", " ")
        remedies = {shown.cause.remedy for shown in report.causes if shown.cause.kind is reason}
        assert all(remedy in console for remedy in remedies)
        return remedies

    assert advice() == {reason.remedy}
    computer.set_state(State.DEGRADED, "altd waited 90% of the time for a processor")
    assert advice() == {FaultCause.BUSY_COMPUTER.remedy}
    computer.set_state(State.OK)
    assert advice() == {reason.remedy}


def test_a_camera_that_failed_comes_first_and_no_busy_computer_explains_its_frames() -> None:
    """Whichever was seen first: a cable that was pulled while the computer was busy."""
    unit = Unit()
    unit.health.component("computer").set_state(State.DEGRADED)
    silent = Fault(Reason.CAMERA_SILENT, "rear", "no frame comes")
    unit.measure(silent, for_s=0.5)
    unit.health.component("camera rear").set_state(State.FAILED, "lost: the cable was pulled")
    first, second, *_ = unit.measure(silent, for_s=MAINTENANCE_DELAY_S).causes
    assert (first.cause.kind, first.cause.of) == (Condition.CAMERA_FAILED, "camera rear")
    assert (second.cause.kind, second.cause.remedy) == (Reason.CAMERA_SILENT, Reason.CAMERA_SILENT.remedy)
    console = " ".join(status_text(unit.published.view()).split())
    assert FaultCause.BUSY_COMPUTER.remedy not in console
    assert "rear target: the camera delivers no frames (no frame comes): see the camera below" in console


def test_a_busy_computer_explains_no_missing_spot() -> None:
    unit = Unit()
    unit.health.component("computer").set_state(State.DEGRADED)
    (dark,) = unit.measure(Fault(Reason.SPOT_MISSING, "front")).causes
    assert dark.cause.remedy == Reason.SPOT_MISSING.remedy
