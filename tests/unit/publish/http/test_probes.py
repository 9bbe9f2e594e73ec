"""/healthz and /readyz, as orchestrators and plant monitors ask them."""

from __future__ import annotations

from support.clock import FakeClock
from support.measurements import changed

from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.status.board import Board
from altd.status.health import Health
from altd.status.state import UnitState

from .conftest import Unit


async def test_a_daemon_that_answers_is_alive_whatever_it_measures(unit: Unit) -> None:
    answer = await unit.ask("/healthz")
    assert (answer.status, answer.json) == (200, {"alive": True})


async def test_a_unit_is_ready_once_it_measures_even_without_a_beam(
    unit: Unit, board: Board, health: Health, clock: FakeClock, measured: Measurement
) -> None:
    health.state = UnitState(board, health, clock).read
    starting = await unit.ask("/readyz")
    board.publish(changed(measured, None, status=(Fault(Reason.SPOT_MISSING, "front"),)))
    without_beam = await unit.ask("/readyz")
    board.publish(measured)
    measuring = await unit.ask("/readyz")
    clock.now_ns += 5_000_000_000
    stale = await unit.ask("/readyz")
    assert (starting.status, stale.status) == (503, 503)
    assert starting.json == {"error": "the unit starts"}
    assert stale.json == {"error": "no new measurement"}
    assert without_beam.json == measuring.json == {"ready": True}
