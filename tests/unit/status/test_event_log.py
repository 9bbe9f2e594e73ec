"""Events: kept in order, bounded, and limited where they repeat."""

import asyncio

import numpy as np
import pytest
from support.clock import FakeClock, stop
from support.measurements import measurement
from support.places import ROOT
from support.status_fixtures import checked

from altd.reasons import Reason
from altd.records import Fault
from altd.selfcheck.records import SelfCheck, Similarity, TargetDrift, Verdict
from altd.status.board import Board
from altd.status.event_log import (
    MAX_EVENTS,
    MAX_OF_ONE_IN_WINDOW,
    MAX_REQUEST_EVENTS,
    MAX_REQUESTS_IN_WINDOW,
    EventKind,
    EventLog,
)
from altd.status.health import Health
from altd.status.services import SelfCheckReport, SelfCheckService
from altd.status.state import StateEvents, UnitState
from altd.status.unit import PublishedUnit


@pytest.fixture
def log(clock: FakeClock) -> EventLog:
    return EventLog(clock)


def texts(log: EventLog) -> list[str]:
    return [event.text for event in log.after(0)]


def test_a_reader_has_a_cursor_and_learns_what_it_missed(log: EventLog, clock: FakeClock) -> None:
    for number in range(MAX_EVENTS + 5):
        clock.now_ns += 10 * 10**9
        log.note(EventKind.STATE, f"{number}")
    left = log.after(0)
    assert log.count == MAX_EVENTS + 5
    assert (len(left), left[0].number, left[-1].number) == (MAX_EVENTS, 6, MAX_EVENTS + 5)
    assert [event.text for event in log.after(log.count - 1)] == [f"{MAX_EVENTS + 4}"]
    assert log.after(log.count) == []


def test_a_million_of_one_kind_cost_some_and_the_last_is_told(log: EventLog, clock: FakeClock) -> None:
    for number in range(1_000_000 // 100):
        clock.now_ns += 10**6
        log.note(EventKind.CAUSE_CAME, f"{number}", "front", 2, {"code": "spot_missing"})
    assert log.count == MAX_OF_ONE_IN_WINDOW
    clock.now_ns += 60 * 10**9
    log.release(clock.now_ns)
    last = log.after(0)[-1]
    assert (last.text, last.held_back) == ("9999", 10_000 - MAX_OF_ONE_IN_WINDOW - 1)
    assert log.count == MAX_OF_ONE_IN_WINDOW + 1


def test_other_causes_are_not_held_back_with_it(log: EventLog) -> None:
    for number in range(50):
        log.note(EventKind.CAUSE_CAME, f"{number}", "front", 2, {"code": "spot_missing"})
    log.note(EventKind.CAUSE_CAME, "other", "front", 2, {"code": "camera_silent"})
    log.note(EventKind.CAUSE_CAME, "rear", "rear", 2, {"code": "spot_missing"})
    assert texts(log)[-2:] == ["other", "rear"]


def test_names_without_end_cost_a_bounded_number(log: EventLog, clock: FakeClock) -> None:
    for number in range(10_000):
        log.note(EventKind.REQUEST, "asked", f"http 10.0.{number >> 8}.{number & 255}")
    assert log.count == MAX_REQUESTS_IN_WINDOW
    clock.now_ns += 61 * 10**9
    log.note(EventKind.STATE, "good")
    assert texts(log)[-1] == "good"
    assert sum(event.held_back + 1 for event in log.after(0)) == 10_001


@pytest.mark.parametrize("kind", [EventKind.REQUEST, EventKind.RECORDING, EventKind.SELF_CHECK])
def test_what_is_asked_for_without_end_takes_the_place_of_no_fault(
    log: EventLog, clock: FakeClock, kind: EventKind
) -> None:
    for minute in range(100):
        for number in range(300):
            log.note(kind, "asked", f"http 10.0.{minute}.{number}")
        for number in range(5):
            log.note(EventKind.CAUSE_CAME, f"{minute} {number}", f"{number}", 2, {"code": "camera_silent"})
        clock.now_ns += 61 * 10**9
    events = log.after(0)
    came = [event.text for event in events if event.kind is EventKind.CAUSE_CAME]
    assert came == [f"{minute} {number}" for minute in range(100) for number in range(5)]
    assert len(events) - len(came) == MAX_REQUEST_EVENTS
    assert [event.number for event in events] == sorted(event.number for event in events)
    assert log.after(events[-6].number) == events[-5:]


def test_control_letters_are_written_as_escapes(log: EventLog) -> None:
    log.note(EventKind.REQUEST, "a\x1b[2Jb\ud800", "http\n10.0.0.1")
    (event,) = log.after(0)
    assert (event.text, event.of) == (r"a\x1b[2Jb\ud800", r"http\n10.0.0.1")


def test_the_page_of_the_history_has_every_kind() -> None:
    page = (ROOT / "docs" / "history.md").read_text()
    for kind in EventKind:
        assert f"| `{kind}` | {kind.meaning} | {kind.severity} |" in page


class TestStateEvents:
    @pytest.fixture
    def service(self, published: PublishedUnit) -> SelfCheckService:
        return published.self_check

    @pytest.fixture
    def log(self, health: Health) -> EventLog:
        return health.events

    @pytest.fixture
    def observer(
        self, log: EventLog, board: Board, health: Health, published: PublishedUnit, clock: FakeClock
    ) -> StateEvents:
        state = UnitState(board, health, clock)
        return StateEvents(log, state.read, published.self_check, clock)

    async def test_causes_come_and_go(
        self, observer: StateEvents, log: EventLog, board: Board, clock: FakeClock
    ) -> None:
        running = asyncio.create_task(observer.run())
        await clock.advance(3.0)
        board.publish(measurement(1, clock.now_ns))
        await clock.advance(2.5)
        board.publish(measurement(2, clock.now_ns, Reason.OUT_OF_RANGE))
        await clock.advance(0.5)
        board.publish(measurement(3, clock.now_ns))
        for sequence in range(4, 16):
            await clock.advance(0.5)
            board.publish(measurement(sequence, clock.now_ns))
        await stop(running)
        told = [(str(one.kind), one.detail.get("code", one.text), one.severity) for one in log.after(0)]
        came = told.index(("cause_came", "out_of_range", 2))
        went = told.index(("cause_went", "out_of_range", 2))
        assert came < went
        assert told[-1] == ("state", "good", 2)
        (gone,) = [event for event in log.after(0) if event.detail.get("code") == "out_of_range"][1:]
        assert gone.detail["for_s"] == pytest.approx(2.5, abs=0.6)
        assert [event.time for event in log.after(0)] == sorted(event.time for event in log.after(0))

    def test_a_self_check_and_who_asked_are_noted(
        self, observer: StateEvents, log: EventLog, service: SelfCheckService
    ) -> None:
        service.open(lambda: None)
        service.ask("modbus")
        service.publish(checked(1, "front has moved", verdict="bad"))
        observer.observe()
        observer.observe()
        told = [event for event in log.after(0) if event.kind in (EventKind.REQUEST, EventKind.SELF_CHECK)]
        assert [(event.of, event.text, event.severity) for event in told] == [
            ("modbus", "a self-check was asked for", 1),
            (None, "bad: front has moved", 4),
        ]
        assert told[1].detail == {"verdict": "bad", "number": 1, "cause": "request", "exposures_lost": 0}

    def test_how_far_each_target_has_moved_is_noted_with_its_check(
        self, observer: StateEvents, log: EventLog, service: SelfCheckService
    ) -> None:
        moved = Similarity((0.0, 0.0), (0.12, -0.3), 0.0, 0.0, np.eye(4), 1.0)
        drifts = {
            "front": TargetDrift("front", 8, 8, (), similarity=moved),
            "rear": TargetDrift("rear", 8, 0, ()),
        }
        service.publish(SelfCheckReport(1, SelfCheck(Verdict.GOOD, drifts, {}), "request"))
        observer.observe()
        (told,) = [event for event in log.after(0) if event.kind is EventKind.SELF_CHECK]
        assert told.detail["shift_px"] == {"front": [0.12, -0.3], "rear": None}


def test_an_event_has_the_target_of_its_fault(
    log: EventLog, board: Board, health: Health, published: PublishedUnit, clock: FakeClock
) -> None:
    observer = StateEvents(log, UnitState(board, health, clock).read, published.self_check, clock)
    fault = Fault(Reason.SPOT_MISSING, "rear", "too dim")
    board.publish(measurement(1, clock.now_ns).without_numbers((fault,)))
    observer.observe()
    (event,) = [event for event in log.after(0) if event.detail.get("code") == "spot_missing"]
    assert (event.of, event.detail["detail"]) == ("rear", "too dim")
