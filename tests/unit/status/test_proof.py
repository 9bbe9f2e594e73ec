from __future__ import annotations

import subprocess
import sys

from support.clock import FakeClock

from altd.instruments.beam.instrument import QUANTITIES
from altd.status.board import Board
from altd.status.proof import Identity, Stamps, crc32, unit_number


def test_the_crc_is_that_of_ieee_802_3() -> None:
    assert crc32(b"123456789") == 0xCBF43926


def test_a_session_is_new_with_every_start() -> None:
    sessions = {Identity.drawn("ALT-0007").session for _ in range(50)}
    assert len(sessions) == 50
    assert all(session is not None and 0 < session < 0xFFFF_FFFF for session in sessions)
    assert {Identity.drawn("ALT-0007").unit for _ in range(3)} == {unit_number("ALT-0007")}


def test_another_process_draws_another_session() -> None:
    script = "from altd.status.proof import Identity; print(Identity.drawn('A').session)"
    drawn = {
        subprocess.run([sys.executable, "-c", script], check=True, capture_output=True).stdout
        for _ in range(2)
    }
    assert len(drawn) == 2


def test_messages_and_the_clock_advance() -> None:
    clock = FakeClock(3_000_000_000)
    stamps = Stamps(Board(clock, 1.0, QUANTITIES, Identity(1, 2)))
    first = stamps.next()
    clock.now_ns += 1_999_999
    second = stamps.next()
    assert (first.message, first.clock_ms) == (1, 0)
    assert (second.message, second.clock_ms) == (2, 1)
    clock.now_ns = 3_000_000_000 + 0xFFFF_FFFF * 1_000_000
    assert stamps.next().clock_ms == 0, "0xFFFFFFFF would read as not known"


def test_the_counts_of_two_faces_are_their_own() -> None:
    board = Board(FakeClock(), 1.0, QUANTITIES, Identity(1, 2))
    ours, theirs = Stamps(board), Stamps(board)
    assert [ours.next().message, ours.next().message, theirs.next().message] == [1, 2, 1]


def test_units_are_told_apart_by_their_serial_numbers() -> None:
    assert len({unit_number(f"ALT-{number:04}") for number in range(2000)}) == 2000
