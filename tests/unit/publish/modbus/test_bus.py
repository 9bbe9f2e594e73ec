"""Following a bus: whose frames are received, and that the end of an answer of others is no request to us."""

import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.modbus_rtu_wire import COLLIDING, READ_OF_20, frame, register_after
from support.modbus_wire import ONE, UNIT

from altd.publish.modbus.rtu import FRAGMENT_TIMEOUT_S, MAX_FRAME_BYTES, Bus, frames_of


def received(*chunks: bytes, gap_s: float = 0.01) -> list[bytes | None]:
    """The unit's reading of chunks with silences between them."""
    bus = Bus(UNIT)
    return [bus.receive(chunk, number * gap_s) for number, chunk in enumerate(chunks)]


def test_an_answer_that_ends_as_a_request_is_no_request() -> None:
    assert received(READ_OF_20, COLLIDING) == [None, None]
    assert received(COLLIDING) == [None]
    assert received(READ_OF_20 + COLLIDING) == [None]
    assert received(*[READ_OF_20, COLLIDING] * 50) == [None] * 100


@pytest.mark.parametrize("torn_at", range(1, len(COLLIDING)))
def test_nor_when_it_comes_in_pieces(torn_at: int) -> None:
    assert received(READ_OF_20, COLLIDING[:torn_at], COLLIDING[torn_at:]) == [None] * 3


@pytest.mark.parametrize("place", range(2, len(COLLIDING) - 8))
def test_nor_when_it_was_damaged_on_its_way(place: int) -> None:
    damaged = bytearray(COLLIDING)
    damaged[place] ^= 0x10
    assert received(READ_OF_20, bytes(damaged)) == [None, None]


def test_our_request_is_heard_behind_all_of_that() -> None:
    for before in ([READ_OF_20, COLLIDING], [READ_OF_20], [COLLIDING], [READ_OF_20, COLLIDING[:20]]):
        assert received(*before, frame(ONE), gap_s=FRAGMENT_TIMEOUT_S + 0.01)[-1] == ONE
    assert received(READ_OF_20, COLLIDING, frame(ONE))[-1] == ONE
    assert received(READ_OF_20 + COLLIDING + frame(ONE)) == [ONE]


def test_a_unit_that_does_not_answer_is_not_waited_for() -> None:
    assert received(READ_OF_20, frame(ONE)) == [None, ONE]
    assert received(READ_OF_20, READ_OF_20, frame(ONE)) == [None, None, ONE]
    assert received(READ_OF_20, b"\x13" + frame(ONE)) == [None, ONE]


@given(st.binary(max_size=200), st.integers(1, 247), st.sampled_from([b"", b"\x00", b"\xff"]))
def test_a_read_behind_any_noise_is_heard(noise: bytes, unit: int, glitch: bytes) -> None:
    """And before the byte that a line driver leaves as it is switched off."""
    request = struct.pack(">BHH", 3, 10, 4)
    assert Bus(unit).receive(noise + frame(request, unit) + glitch, 0.0) == request


@pytest.mark.parametrize("glitch", [b"\x00", b"\xff"])
def test_a_command_before_a_stray_byte_is_none(glitch: bytes) -> None:
    command = struct.pack(">BHH", 6, 100, 1)
    assert Bus(UNIT).receive(frame(command, UNIT) + glitch, 0.0) != command


STREAM_OF_TWO_READINGS = [
    (0, bytes.fromhex("c18000000000000000000000")),  # the CRC of its first four bytes fits, too
    (234, bytes.fromhex("0000002e")),
    (UNIT, bytes.fromhex("00800000bc0000")),
    (0, bytes.fromhex("00007300000000800000000000bd000080")),
    (UNIT, bytes.fromhex("00d8000000000000370000d781")),
    (60, bytes.fromhex("0000000000000000800000298f00bd")),
    (33, bytes.fromhex("0000800000000000008000808080800000")),
]


def ways_to_split(received: bytes) -> int:
    """In how many ways bytes are runs with a CRC that fits, each as long as a frame can be."""
    ways = [1] + [0] * len(received)
    for begin in range(len(received)):
        register = 0xFFFF
        for end in range(begin + 1, min(len(received), begin + 256) + 1 if ways[begin] else 0):
            register = register_after(received[end - 1 : end], register)
            if register == 0 and end - begin >= 4:
                ways[end] += ways[begin]
    return ways[-1]


@given(st.lists(st.tuples(st.integers(0, 247), st.binary(min_size=1, max_size=60)), min_size=1, max_size=8))
@example(STREAM_OF_TWO_READINGS)
def test_frames_to_this_unit_are_told_apart_whatever_they_hold(said: list[tuple[int, bytes]]) -> None:
    """Unless their CRCs leave more than one way to split them: then one of these ways is found."""
    frames = [frame(bytes([0x41]) + content, unit) for unit, content in said]
    received = b"".join(frames)
    found = frames_of(received, UNIT)
    assert found is not None
    assert b"".join(found) == received
    assert all(register_after(each) == 0 for each in found)
    assert found == frames or ways_to_split(received) > 1


@given(st.lists(st.binary(min_size=1, max_size=300), max_size=20), st.floats(0, 0.2))
def test_whatever_is_heard_a_request_has_a_frame_that_holds_it(chunks: list[bytes], gap_s: float) -> None:
    for number, request in enumerate(received(*chunks, gap_s=gap_s)):
        assert request is None or b"".join(chunks[: number + 1]).endswith(frame(request))


def test_the_longest_frame_is_heard() -> None:
    longest = frame(bytes(MAX_FRAME_BYTES - 3))
    assert received(longest) == [longest[1:-2]]
