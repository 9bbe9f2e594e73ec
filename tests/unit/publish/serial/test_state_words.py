"""The console says the state with its causes, and never a better availability than there was."""

import pytest
from support.clock import FakeClock
from support.measurements import measurement

from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.serial.words import WIDTH, status_text
from altd.reasons import Reason
from altd.status.board import Board
from altd.status.cause import Cause
from altd.status.conditions import Condition
from altd.status.health import Health, State
from altd.status.state import UnitState
from altd.status.unit import PublishedUnit, UnitFacts


class Told:
    """A unit that has measured for a minute, as `status` tells of it."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        self.board = Board(self.clock, 1.0, QUANTITIES)
        self.health = Health(self.clock)
        self.causes: list[Cause] = []
        state = UnitState(self.board, self.health, self.clock, [lambda now_ns: self.causes])
        self.published = PublishedUnit(self.board, self.health, state=state.read)

    def measure(self, seconds: int, *reasons: Reason) -> None:
        for _ in range(2 * seconds):
            self.clock.now_ns += 500_000_000
            self.board.publish(measurement(1, self.clock.now_ns, *reasons))
            self.published.state()

    def text(self, *, whole: bool = False) -> str:
        return status_text(self.published.view(), whole=whole)

    def words(self, *, whole: bool = False) -> str:
        """Without its line breaks."""
        return " ".join(self.text(whole=whole).split())


@pytest.fixture
def told() -> Told:
    unit = Told()
    unit.measure(60)
    return unit


def test_a_good_unit_says_so_with_its_availability(told: Told) -> None:
    assert "state good for 59 s" in told.words()  # it was starting until its first measurement
    assert "available 99.16 % of the last 1 min; 99.16 % since the start " in told.words()
    told.measure(3600)
    assert "100.00 % of the last hour; 99.98 % of the last 1 h 1 min; 99.98 % since the" in told.words()
    assert "nothing is wrong" in told.words()


def test_the_state_and_whether_it_measures_come_first_and_facts_of_makers_last(told: Told) -> None:
    told.published.facts = UnitFacts(version="1", unit_number="1E4B", spot_fit="compiled", calibration="c")
    names = [line.split("  ")[0] for line in told.text().split("\n\n")[0].split("\n") if line[0] != " "]
    assert names[:2] == ["state", "measuring"]
    assert names[-2:] == ["unit_number", "spot_fit"]


def test_who_set_the_zero_is_said(told: Told) -> None:
    assert "zero not set since the start" in told.words()
    told.published.zero.set(told.board, "modbus 10.0.0.5")
    assert "zero time not known, by modbus 10.0.0.5" in told.words()


def test_every_cause_is_named_with_what_to_do(told: Told) -> None:
    told.health.component("serial /dev/ttyS0").set_state(State.FAILED, "no such device")
    told.causes = [Cause(Condition.LASER_WEAK, "front", "40 % of its reference")]
    told.measure(20, Reason.SPOT_MISSING)
    words = told.words()
    assert "state OUT OF SPECIFICATION for 19 s: no laser spot;" in words
    assert "a connection to the outside has failed (serial /dev/ttyS0)" in words
    assert "the laser has become weak (front)" in words
    assert "(40 % of its reference): clean the window, check the laser's supply and age" in words
    assert words.count("no such device") == 1  # said by the component


def test_a_cause_that_has_just_gone_is_said_to_be_gone(told: Told) -> None:
    told.measure(1, Reason.SPOT_MISSING)
    told.measure(1)
    assert "no laser spot - just now" in told.words()


def test_lost_time_is_named_on_request(told: Told) -> None:
    told.measure(30, Reason.SPOT_MISSING)
    assert "lost: spot_missing 30 s" not in told.words()
    assert "since the start (lost: spot_missing 30 s, starting 0.5 s)" in told.words(whole=True)


def test_no_line_is_wider_than_the_screen(told: Told) -> None:
    told.causes = [Cause(condition, "front", "seen " * 30) for condition in Condition]
    told.measure(20, Reason.SPOT_MISSING)
    assert max(map(len, told.text(whole=True).split("\n"))) <= WIDTH
    assert told.text(whole=True).isascii()
