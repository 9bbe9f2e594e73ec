"""The unit's state: no cause is hidden by a worse one, and nothing unknown is good."""

import asyncio
from typing import cast

import pytest
from support.clock import stop

from altd.reasons import Reason, Signal
from altd.records import Fault
from altd.status.cause import HOLD_S, MAINTENANCE_DELAY_S, Cause, Kind
from altd.status.causes import START_S
from altd.status.conditions import Condition
from altd.status.health import MEASURING, State
from altd.status.models import status_of
from altd.status.state import UnitState

from .clocked_unit import Unit, kinds


def test_a_unit_that_measures_and_whose_components_are_well_is_good() -> None:
    unit = Unit()
    for name in (MEASURING, "camera front", "lamps"):
        unit.health.component(name).set_state(State.OK)
    report = unit.measure(for_s=30)
    assert (str(report.signal), report.causes) == ("good", ())


def test_every_cause_is_listed_the_worst_first() -> None:
    unit = Unit()
    unit.health.component("camera rear").set_state(State.FAILED, "lost: unplugged")
    unit.health.component("http 0.0.0.0:8080").set_state(State.FAILED, "no route")
    unit.watched = [Cause(Condition.TOO_HOT, "housing", "61 C"), Cause(Condition.CALIBRATION_DUE)]
    status = (Fault(Reason.SPOT_MISSING, "front"), Fault(Reason.SPOT_MISSING, "rear"), Fault(Reason.PLAYBACK))
    report = unit.measure(*status, for_s=MAINTENANCE_DELAY_S)
    assert [(shown.cause.kind, shown.cause.of) for shown in report.causes] == [
        ("camera_failed", "camera rear"),
        ("not_live", None),
        ("playback", None),
        ("spot_missing", "front"),
        ("spot_missing", "rear"),
        ("too_hot", "housing"),
        ("face_failed", "http 0.0.0.0:8080"),
        ("calibration_due", None),
    ]
    assert str(report.signal) == "failure"


@pytest.mark.parametrize("reason", Reason)
def test_a_measurement_that_is_not_plainly_valid_is_never_good_even_for_an_instant(reason: Reason) -> None:
    unit = Unit()
    unit.measure(for_s=30)
    unit.publish(Fault(reason))
    report = unit.state.read()
    if reason.signal is Signal.MAINTENANCE_REQUIRED:
        assert report.signal is Signal.GOOD  # its numbers may be used; one lost frame raises no alarm
    else:
        assert report.signal is reason.signal


def test_an_invalid_measurement_without_a_reason_is_a_failure() -> None:
    unit = Unit()
    unit.publish(valid=False)
    assert str(unit.state.read().signal) == "failure"
    unit.publish(Fault(Reason.EXPOSURES_LOST), valid=False)  # a warning is no reason
    assert kinds(unit.state.read()) >= {"unknown_reason"}


def test_a_state_that_is_in_no_table_is_a_failure() -> None:
    unit = Unit()
    unit.health.component("camera front").set_state(cast("State", "confused"))
    assert str(unit.measure().signal) == "failure"


def test_a_cause_whose_table_calls_it_good_is_a_failure() -> None:
    class Odd:
        signal = Signal.GOOD
        brief = remedy = "odd"

    unit = Unit()
    unit.watched = [Cause(cast("Kind", Odd()))]
    assert str(unit.measure().signal) == "failure"


def test_a_watch_that_breaks_is_a_failure_and_hides_no_other_cause() -> None:
    unit = Unit()

    def broken(now_ns: int) -> list[Cause]:
        raise ZeroDivisionError

    watches = [broken, lambda now_ns: [Cause(Condition.TOO_HOT)]]
    state = UnitState(unit.board, unit.health, unit.clock, watches)
    unit.clock.now_ns += round(60e9)
    unit.publish()
    report = state.read()
    assert kinds(report) == {"component_failed", "too_hot"}
    assert str(report.signal) == "failure"


class TestStarting:
    def test_cameras_that_open_are_no_failure_and_nothing_is_good_before_it_is_measured(self) -> None:
        unit = Unit(running_s=0)
        camera = unit.health.component("camera front")
        camera.set_state(State.FAILED, "not found")
        assert (str(unit.state.read().signal), kinds(unit.state.read())) == ("check_function", {"starting"})
        unit.publish(Fault(Reason.CAMERA_SILENT, "front"))
        assert kinds(unit.state.read()) == {"starting"}
        unit.clock.now_ns = round(START_S * 1e9)
        unit.publish(Fault(Reason.CAMERA_SILENT, "front"))
        assert str(unit.state.read().signal) == "failure"

    def test_ends_with_the_first_valid_measurement(self) -> None:
        unit = Unit(running_s=0.5)
        assert kinds(unit.state.read()) == {"starting"}
        unit.measure(for_s=HOLD_S + 0.5)
        assert str(unit.state.read().signal) == "good"

    def test_what_no_camera_brings_about_is_a_failure_even_then(self) -> None:
        unit = Unit(running_s=0.5)
        unit.publish(Fault(Reason.CHECK_FAILED))
        assert str(unit.state.read().signal) == "failure"


class TestFlapping:
    def test_a_cause_that_comes_and_goes_is_one_that_stays_with_its_count(self) -> None:
        unit = Unit()
        unit.measure(for_s=10)
        signals = set()
        for _ in range(20):
            signals |= {unit.measure(Fault(Reason.SPOT_MISSING, "front")).signal}
            unit.clock.now_ns += round(0.5e9)
            signals |= {unit.measure().signal}
            unit.clock.now_ns += round(0.5e9)
        report = unit.state.read()
        assert signals == {Signal.OUT_OF_SPECIFICATION}
        (shown,) = report.causes
        assert (shown.times, shown.is_active) == (20, False)
        assert report.now_ns - shown.since_ns == round(20e9)

    def test_it_goes_when_it_was_not_true_for_the_hold(self) -> None:
        unit = Unit()
        unit.measure(Fault(Reason.SPOT_MISSING, "front"))
        unit.clock.now_ns += round(HOLD_S * 1e9)
        assert str(unit.measure().signal) == "out_of_specification"
        unit.clock.now_ns += 1
        assert str(unit.measure().signal) == "good"

    def test_a_frame_lost_now_and_then_asks_for_no_maintenance_but_many_do(self) -> None:
        lost = Fault(Reason.EXPOSURES_LOST)
        unit = Unit()
        for _ in range(10):
            unit.measure(lost, for_s=1)
            assert str(unit.measure(for_s=MAINTENANCE_DELAY_S + 1).signal) == "good"
        for _ in range(4):
            unit.measure(lost, for_s=1)
            report = unit.measure(for_s=MAINTENANCE_DELAY_S / 2)
        assert str(report.signal) == "maintenance_required"

    def test_a_process_that_stood_still_does_not_make_an_old_cause_a_long_one(self) -> None:
        unit = Unit()
        unit.measure(Fault(Reason.SPOT_MISSING, "front"))
        unit.clock.now_ns += round(3600e9)
        report = unit.measure()
        assert (str(report.signal), report.causes) == ("good", ())


class TestJson:
    def test_status_has_the_state_with_all_causes_and_the_availability(self) -> None:
        unit = Unit()
        unit.watched = [Cause(Condition.TOO_HOT, "housing", "61.0 C")]
        unit.measure(Fault(Reason.SPOT_MISSING, "front", "dark"), for_s=4)
        document = status_of(unit.published.view()).as_object()
        assert document["state"] == {
            "signal": "out_of_specification",
            "number": 3,
            "for_s": 4.0,
            "causes": [
                {
                    "code": "spot_missing",
                    "signal": "out_of_specification",
                    "of": "front",
                    "active": True,
                    "for_s": 4.0,
                    "times": 1,
                    "brief": "no laser spot",
                    "remedy": "switch the laser on and check that its beam enters the window",
                    "detail": "dark",
                },
                {
                    "code": "too_hot",
                    "signal": "out_of_specification",
                    "of": "housing",
                    "active": True,
                    "for_s": 4.0,
                    "times": 1,
                    "brief": "it is too hot",
                    "remedy": "shade or cool the unit",
                    "detail": "61.0 C",
                },
            ],
        }
        assert "availability" in document


async def test_the_task_looks_when_nobody_asks() -> None:
    unit = Unit()
    unit.health.component("camera front").set_state(State.FAILED)
    task = asyncio.create_task(unit.state.run())
    unit.publish()
    await unit.clock.advance(1.0)
    unit.health.component("camera front").set_state(State.OK)
    report = unit.measure()
    await stop(task)
    assert kinds(report) == {"camera_failed"}  # seen by the task, and held
