from __future__ import annotations

import asyncio

import pytest
from support.clock import FakeClock, settle
from support.measurements import measurement

from altd.records import Reason
from altd.service.board import Board


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def board(clock: FakeClock) -> Board:
    return Board(clock, stale_after_s=1.0)


def test_an_empty_board_reads_nothing(board: Board) -> None:
    assert board.read() is None
    assert board.age_s() is None


async def test_a_value_that_nothing_follows_loses_its_numbers(board: Board, clock: FakeClock) -> None:
    put_up = measurement()
    board.publish(put_up)
    await clock.advance(1.0)
    assert board.read() is put_up
    await clock.advance(0.001)
    stale = board.read()
    assert stale is not None
    assert not stale.valid
    assert stale.points_mm == {"front": None, "rear": None}
    assert [fault.reason for fault in stale.status] == [Reason.STALE]
    assert stale.sequence == put_up.sequence


async def test_a_reader_that_is_late_gets_the_latest_and_knows_what_it_skipped(board: Board) -> None:
    cursor = board.cursor()
    for sequence in range(5):
        board.publish(measurement(sequence))
    assert (await cursor.next()).sequence == 4
    assert cursor.skipped == 4
    waiting = asyncio.create_task(cursor.next())
    await settle()
    assert not waiting.done()
    board.publish(measurement(5))
    assert (await waiting).sequence == 5
    assert cursor.skipped == 4


async def test_readers_have_places_of_their_own(board: Board) -> None:
    board.publish(measurement(1))
    first, second = board.cursor(), board.cursor()
    assert (await first.next()).sequence == 1
    board.publish(measurement(2))
    assert (await first.next()).sequence == 2
    assert (await second.next()).sequence == 2
    assert (first.skipped, second.skipped) == (0, 1)
