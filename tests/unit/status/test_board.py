import asyncio
import subprocess
import sys
from dataclasses import replace

import pytest
from support.clock import FakeClock, settle
from support.measurements import measurement, points_of

from altd.instruments.beam.instrument import QUANTITIES
from altd.reasons import Reason
from altd.records import Fault, Finding, Measurement
from altd.status.board import Board
from altd.status.proof import Identity, Stamps, unit_number


def test_an_empty_board_reads_nothing(board: Board) -> None:
    assert board.read() is None
    assert board.age_s() is None


async def test_a_value_that_nothing_follows_loses_its_numbers(board: Board, clock: FakeClock) -> None:
    published = measurement()
    board.publish(published)
    await clock.advance(1.0)
    assert board.read() is published
    await clock.advance(0.001)
    stale = board.read()
    assert not stale.valid
    assert points_of(stale) == {"front": None, "rear": None}
    assert [fault.reason for fault in stale.status] == [Reason.STALE]
    assert stale.sequence == published.sequence


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


async def test_what_waited_on_its_way_is_as_old_as_its_light(board: Board, clock: FakeClock) -> None:
    """As when the process was held for 10 s and then measures the frames that lay in its buffers."""
    await clock.advance(20.0)
    waited = replace(measurement(), t_ns=clock.now_ns - 105 * 10**8, last_exposure_ns=clock.now_ns - 10**10)
    board.publish(waited)
    read = board.read()
    assert (read.valid, [fault.reason for fault in read.status]) == (False, [Reason.STALE])
    board.publish(replace(waited, last_exposure_ns=clock.now_ns - 50_000_000))
    assert board.read() == replace(waited, last_exposure_ns=clock.now_ns - 50_000_000)


async def test_a_long_window_is_as_young_as_its_last_exposure(board: Board, clock: FakeClock) -> None:
    await clock.advance(60.0)
    mean = replace(measurement(), t_ns=clock.now_ns - 25 * 10**9, last_exposure_ns=clock.now_ns - 60_000_000)
    board.publish(mean)
    assert board.read() is mean
    await clock.advance(0.95)
    stale = board.read()
    assert not stale.valid


async def test_what_claims_to_be_of_the_future_ages_all_the_same(board: Board, clock: FakeClock) -> None:
    board.publish(replace(measurement(), t_ns=clock.now_ns + 3600 * 10**9))
    await clock.advance(1.001)
    read = board.read()
    assert not read.valid


@pytest.mark.parametrize("origin", [Reason.PLAYBACK, Reason.SIMULATED])
def test_what_is_not_from_this_units_cameras_is_invalid_however_good(board: Board, origin: Reason) -> None:
    played = measurement(3, 8_000_000_000, origin)
    assert played.valid
    published = board.publish(played)
    assert board.read() is published
    assert not published.valid
    assert (published.values, published.motions) == ({}, {})
    assert points_of(published) == {"front": None, "rear": None}
    assert [str(fault) for fault in published.status] == ["not_live", str(origin)]
    assert published.status[0].detail == str(origin)


@pytest.mark.parametrize(
    ("is_bad", "rehearsal", "status"),
    [
        (True, False, ["not_live", "geometry_drift", "simulated", "roll_missing"]),
        (True, True, ["geometry_drift", "simulated", "roll_missing", "rehearsal"]),
        (False, False, ["not_live", "simulated", "geometry_drift", "roll_missing"]),
        (False, True, ["simulated", "geometry_drift", "roll_missing", "rehearsal"]),
    ],
)
def test_what_takes_the_numbers_comes_first_and_a_sensor_sees_only_numbers_that_stay(
    clock: FakeClock, is_bad: bool, rehearsal: bool, status: list[str]
) -> None:
    compared: list[object] = []

    def sense(measurement: Measurement) -> Finding:
        compared.append(measurement.values)
        return Finding((Fault(Reason.ROLL_MISSING),))

    board = Board(clock, 1.0, QUANTITIES, sense=sense, rehearsal=rehearsal)
    solved = measurement(3, 0, Reason.SIMULATED)
    published = board.publish(solved, Finding((Fault(Reason.GEOMETRY_DRIFT),), withdraws=is_bad))
    assert [str(fault) for fault in published.status] == status
    assert published.valid is (rehearsal and not is_bad)
    assert compared == [{} if is_bad else solved.values]


def test_in_a_rehearsal_it_keeps_its_numbers_and_every_measurement_says_so(clock: FakeClock) -> None:
    board = Board(clock, 1.0, QUANTITIES, rehearsal=True)
    for origin in ((Reason.SIMULATED,), ()):
        published = board.publish(measurement(3, 0, *origin))
        assert published.valid
        assert [fault.reason for fault in published.status] == [*origin, Reason.REHEARSAL]
    board.publish(measurement(4, 0, Reason.SPOT_MISSING))
    lost = board.read()
    assert not lost.valid
    assert Reason.REHEARSAL in {fault.reason for fault in lost.status}


def test_a_session_is_new_with_every_start() -> None:
    sessions = {Identity.drawn("ALT-0007").session for _ in range(50)}
    assert len(sessions) == 50
    assert all(session is not None and 0 < session < 0xFFFF_FFFF for session in sessions)
    assert {Identity.drawn("ALT-0007").unit for _ in range(3)} == {unit_number("ALT-0007")}


def test_another_process_draws_another_session() -> None:
    script = "from altd.status.proof import Identity; print(Identity.drawn('A').session)"
    command = [sys.executable, "-c", script]
    drawn = {subprocess.run(command, check=True, capture_output=True).stdout for _ in range(2)}
    assert len(drawn) == 2


def test_messages_and_the_clock_advance() -> None:
    clock = FakeClock(3_000_000_000)
    stamps = Stamps(Board(clock, 1.0, QUANTITIES, Identity(1, 2)), "mqtt")
    first = stamps.next()
    clock.now_ns += 1_999_999
    second = stamps.next()
    assert (first.message, first.clock_ms) == (1, 0)
    assert (second.message, second.clock_ms) == (2, 1)
    clock.now_ns = 3_000_000_000 + 0xFFFF_FFFF * 1_000_000
    assert stamps.next().clock_ms == 0, "0xFFFFFFFF would read as not known"


def test_the_counts_of_two_faces_are_their_own() -> None:
    board = Board(FakeClock(), 1.0, QUANTITIES, Identity(1, 2))
    ours, theirs = Stamps(board, "ours"), Stamps(board, "theirs")
    assert [ours.next().message, ours.next().message, theirs.next().message] == [1, 2, 1]
    reopened, added = Stamps(board, "theirs"), Stamps(board, "added")
    assert (reopened.next().message, added.next().message) == (2, 3), "a number goes back within a session"
