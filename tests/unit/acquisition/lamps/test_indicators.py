import asyncio
from collections.abc import AsyncIterator

import pytest
from support.clock import FakeClock, stop
from support.measurements import measurement

from altd.acquisition.lamps.indicators import (
    OK_LIGHT,
    DataFlash,
    IndicatorPanel,
    Light,
    error_light,
    validity_of,
)
from altd.instruments.beam.instrument import QUANTITIES
from altd.ports import Indicator
from altd.reasons import Reason
from altd.records import Measurement
from altd.status.board import Board
from altd.status.cause import Cause
from altd.status.conditions import Condition
from altd.status.health import Health, State
from altd.status.state import UnitState
from altd.status.unit import PublishedUnit

DARK, BLINKS, STEADY = Light.DARK, Light.BLINKS, Light.STEADY


def after(*reasons: Reason) -> Measurement:
    return measurement(160, 8_000_000_000, *reasons)


@pytest.mark.parametrize(
    ("latest", "running_s", "failed", "ok", "error"),
    [
        (after(), 60, False, STEADY, DARK),
        (after(), 60, True, STEADY, BLINKS),
        (after(Reason.EXPOSURES_LOST), 60, False, BLINKS, DARK),
        (after(Reason.PLAYBACK), 60, True, BLINKS, BLINKS),
        (after(Reason.SPOT_MISSING), 60, False, DARK, STEADY),
        (after(Reason.SPOT_MISSING), 60, True, DARK, STEADY),
        (after(Reason.CAMERA_SILENT, Reason.SIMULATED), 60, True, DARK, STEADY),
        (after(Reason.WARMING_UP), 60, False, BLINKS, DARK),
        (after(Reason.WARMING_UP, Reason.PLAYBACK), 60, True, BLINKS, BLINKS),
        (after(Reason.NOT_LIVE, Reason.PLAYBACK), 60, False, DARK, STEADY),
        (after(Reason.WARMING_UP, Reason.STALE), 60, False, DARK, STEADY),
        (None, 0, False, BLINKS, DARK),
        (None, 1.9, False, BLINKS, DARK),
        (None, 2.1, False, DARK, STEADY),
        (after(Reason.CAMERA_SILENT), 1.9, False, BLINKS, DARK),  # cameras take time to open
        (after(Reason.CAMERA_SILENT), 1.9, True, BLINKS, BLINKS),
        (after(Reason.CAMERA_SILENT), 2.1, False, DARK, STEADY),
    ],
)
def test_ok_and_error_tell_how_the_measurement_is(
    latest: Measurement | None, running_s: float, failed: bool, ok: Light, error: Light
) -> None:
    validity = validity_of(latest, running_s)
    assert (OK_LIGHT[validity], error_light(validity, failed)) == (ok, error)


def test_what_blinks_does_so_once_a_second() -> None:
    lit = [BLINKS.lit_at(round(0.1 * tenth * 1e9)) for tenth in range(20)]
    assert lit == [*[True] * 5, *[False] * 5] * 2
    assert all(STEADY.lit_at(t_ns) and not DARK.lit_at(t_ns) for t_ns in range(0, 10**9, 10**8))


@pytest.mark.parametrize(
    ("given", "lit"),
    [
        ([0, 0, 0], [0, 0, 0]),
        ([1, 1, 1], [1, 0, 0]),
        ([0, 1, 2, 2, 2], [0, 1, 0, 1, 0]),
        ([3, 6, 9, 12, 15], [1, 0, 1, 0, 1]),  # a stream flickers
    ],
)
def test_data_flashes_for_a_tick(given: list[int], lit: list[int]) -> None:
    flash = DataFlash()
    assert [int(flash.lit(count)) for count in given] == lit


class Row:
    """Four lamps that a test can see."""

    def __init__(self) -> None:
        self.lit: frozenset[Indicator] = frozenset()
        self.looks: list[frozenset[Indicator]] = []

    def open(self) -> None:
        self.lit = frozenset()

    def show(self, lit: frozenset[Indicator]) -> None:
        self.lit = lit
        self.looks.append(lit)

    def close(self) -> None:
        self.lit = frozenset()


class TestPanel:
    @pytest.fixture
    def health(self, clock: FakeClock) -> Health:
        return Health(clock)

    @pytest.fixture
    def board(self, clock: FakeClock) -> Board:
        return Board(clock, 3600, QUANTITIES)

    @pytest.fixture
    def published(self, board: Board, health: Health) -> PublishedUnit:
        return PublishedUnit(board, health)

    @pytest.fixture
    async def row(self, published: PublishedUnit, health: Health, clock: FakeClock) -> AsyncIterator[Row]:
        row = Row()
        panel = IndicatorPanel(row, published, health.component("indicators"))
        task = asyncio.create_task(panel.run())
        yield row
        assert Indicator.POWER in row.lit
        await stop(task)
        assert row.lit == frozenset()

    async def seen(self, row: Row, clock: FakeClock, *wanted: Indicator) -> None:
        """Wait until these are lit."""
        await clock.until(lambda: row.lit == frozenset(wanted))

    async def test_follows_board_and_health(
        self, row: Row, board: Board, health: Health, clock: FakeClock
    ) -> None:
        await self.seen(row, clock, Indicator.POWER, Indicator.OK)
        await clock.advance(2)
        await self.seen(row, clock, Indicator.POWER, Indicator.ERROR)
        board.publish(after())
        await self.seen(row, clock, Indicator.POWER, Indicator.OK)
        publisher = health.component("modbus_tcp")
        publisher.set_state(State.FAILED)
        await self.seen(row, clock, Indicator.POWER, Indicator.OK, Indicator.ERROR)
        publisher.set_state(State.OK)
        await self.seen(row, clock, Indicator.POWER, Indicator.OK)
        publisher.gave_data()
        await self.seen(row, clock, Indicator.POWER, Indicator.OK, Indicator.DATA)
        await self.seen(row, clock, Indicator.POWER, Indicator.OK)

    async def test_error_blinks_for_a_cause_of_the_unit_state_while_it_measures(
        self, row: Row, board: Board, health: Health, published: PublishedUnit, clock: FakeClock
    ) -> None:
        causes = [Cause(Condition.TOO_HOT, "housing", "61.0 C")]
        published.state = UnitState(board, health, clock, [lambda now_ns: causes]).read
        board.publish(after())
        await self.seen(row, clock, Indicator.POWER, Indicator.OK, Indicator.ERROR)
        await self.seen(row, clock, Indicator.POWER, Indicator.OK)  # it blinks
        causes.clear()
        await clock.advance(2.5)
        looks = len(row.looks)
        await clock.advance(5)
        assert not any(Indicator.ERROR in lit for lit in row.looks[looks + 1 :])

    async def test_sets_the_lamps_only_when_something_changes(
        self, row: Row, board: Board, clock: FakeClock
    ) -> None:
        board.publish(after())
        await self.seen(row, clock, Indicator.POWER, Indicator.OK)
        before = len(row.looks)
        await clock.advance(8.0)
        looks = row.looks[before:]
        assert set(looks) == {frozenset({Indicator.POWER, Indicator.OK})}
        assert len(looks) <= 9  # it looks once a second whether the lamps are still there
