"""The zero: which measurement becomes it, and what is relative to it."""

import math
from datetime import UTC, datetime
from typing import Any

import pytest
from support.clock import FakeClock
from support.measurements import measured

from altd.instruments.beam.instrument import QUANTITIES
from altd.instruments.beam.solver import Beam
from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.status.board import Board
from altd.status.event_log import EventLog
from altd.status.zero import NoZeroError, Zero

KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")


def at(x_mm: float, sigma_mm: float, t_ns: int, *status: Fault, **more: Any) -> Measurement:
    beam = Beam(x_mm, 5.0, 1.5, -1.75, sigma_mm, 0.004, 0.001, 0.002)
    points = {"front": (x_mm, 5.0), "rear": (x_mm + 5, 5.0)}
    time = datetime(2026, 11, 20, tzinfo=UTC)
    return measured(beam, points, sequence=1, t_ns=t_ns, time=time, frames=20, status=status, **more)


@pytest.fixture
def zero(clock: FakeClock) -> Zero:
    return Zero(EventLog(clock))


def test_differences_have_the_sigma_of_both(zero: Zero, board: Board, clock: FakeClock) -> None:
    zero_at, now = at(10.0, 0.003, clock.now_ns), at(12.5, 0.004, clock.now_ns)
    board.publish(zero_at)
    zero.set(board, "modbus")
    found = zero.state.difference("x_mm", now)
    assert (found.value, found.sigma) == (2.5, pytest.approx(0.005))
    for key in KEYS[1:]:
        found = zero.state.difference(key, now)
        sigma = now.sigma(key)
        assert sigma is not None
        assert (found.value, found.sigma) == (0.0, pytest.approx(math.sqrt(2) * sigma))
    assert board.read() is zero_at, "what is published stays"


def test_no_difference_without_a_zero_or_a_measurement(zero: Zero, board: Board, clock: FakeClock) -> None:
    live = at(10.0, 0.003, clock.now_ns)
    assert zero.state.difference("x_mm", live) is None
    board.publish(live)
    zero.set(board, "modbus")
    assert zero.state.difference("x_mm", None) is None
    lost = live.without_numbers((Fault(Reason.STALE),))
    assert [zero.state.difference(key, lost) for key in KEYS] == [None] * 4
    assert zero.state.difference("roll_deg", live) is None


@pytest.mark.parametrize("why", ["nothing yet", "invalid", "stale", "simulated", "played"])
def test_only_a_valid_live_and_fresh_measurement_becomes_the_zero(
    zero: Zero, board: Board, clock: FakeClock, why: str
) -> None:
    board.publish(at(10.0, 0.003, clock.now_ns))
    zero.set(board, "modbus")
    before, number = zero.state.measurement, zero.state.next_number
    if why == "nothing yet":
        board = Board(clock, 1.0, QUANTITIES)
    elif why == "invalid":
        board.publish(at(11.0, 0.003, clock.now_ns).without_numbers((Fault(Reason.UNSTEADY),)))
    elif why == "stale":
        clock.now_ns += 1_100_000_000
    else:
        reason = Reason.SIMULATED if why == "simulated" else Reason.PLAYBACK
        board.publish(at(11.0, 0.003, clock.now_ns, Fault(reason)))
    with pytest.raises(NoZeroError, match="not valid"):
        zero.set(board, "modbus")
    assert (zero.state.measurement, zero.state.count, zero.state.next_number) == (before, 1, number)


def test_a_rehearsal_can_set_a_zero_which_ends_with_it(zero: Zero, clock: FakeClock) -> None:
    board = Board(clock, 1.0, QUANTITIES, rehearsal=True)
    board.publish(at(10.0, 0.003, clock.now_ns, Fault(Reason.SIMULATED)))
    zero.set(board, "modbus")
    assert zero.state.count == 1


def test_each_zero_has_its_own_number_and_a_session_its_first(board: Board, clock: FakeClock) -> None:
    sessions = [Zero(EventLog(clock)) for _ in range(20)]
    assert len({zero.state.next_number for zero in sessions}) > 1
    board.publish(at(10.0, 0.003, clock.now_ns))
    numbers = []
    for _ in range(100):
        numbers.append(sessions[0].state.next_number)
        sessions[0].set(board, "modbus")
    assert len(set(numbers)) == 100
    assert all(0 <= number < 0xFFFF for number in numbers)
