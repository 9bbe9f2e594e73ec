"""Token buckets and sessions, on a clock that the test drives."""

from __future__ import annotations

import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.clock import FakeClock

from altd.publish.http.clients import IDLE_S, MAX_SESSION_S, MAX_SESSIONS, Sessions
from altd.tcp_port import MAX_KEYS, Buckets, Rate

S = 1_000_000_000


def test_a_burst_is_free_and_then_it_goes_by_the_rate() -> None:
    clock = FakeClock(5 * S)
    buckets = Buckets(Rate(burst=3, per_s=2.0), clock)
    assert [buckets.take("a") for _ in range(3)] == [0, 0, 0]
    assert buckets.take("a") == pytest.approx(0.5)
    assert buckets.take("b") == 0
    clock.now_ns += S // 2
    assert buckets.take("a") == 0
    assert buckets.take("a") == pytest.approx(0.5)
    clock.now_ns += 100 * S
    assert [buckets.take("a") for _ in range(3)] == [0, 0, 0]
    assert buckets.take("a") > 0


def test_what_is_given_back_can_be_taken_again() -> None:
    buckets = Buckets(Rate(burst=1, per_s=0.1), FakeClock(S))
    assert buckets.take("a") == 0
    buckets.put_back("a")
    buckets.put_back("unknown")
    assert buckets.take("a") == 0
    assert buckets.wait_s("a") == pytest.approx(10.0)


@given(st.lists(st.integers(0, 3 * S), max_size=200))
def test_in_no_time_more_is_taken_than_the_rate_gives(pauses_ns: list[int]) -> None:
    clock = FakeClock(7 * S)
    buckets, taken = Buckets(Rate(burst=4, per_s=2.0), clock), list[int]()
    for pause_ns in pauses_ns:
        clock.now_ns += pause_ns
        if buckets.take("a") == 0:
            taken.append(clock.now_ns)
    for first, begin_ns in enumerate(taken):
        for last in range(first, len(taken)):
            assert last - first + 1 <= 4 + 2.0 * (taken[last] - begin_ns) / S + 1e-6


def test_memory_is_bounded_whoever_asks() -> None:
    buckets = Buckets(Rate(burst=1, per_s=0.001), FakeClock(S))
    tracemalloc.start()
    for number in range(50_000):
        buckets.take(f"10.{number >> 16}.{number >> 8 & 255}.{number & 255}")
    size, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert size < MAX_KEYS * 1000
    assert buckets.take("10.0.195.79") > 0  # the last one is remembered
    assert buckets.take("10.0.0.0") == 0  # the first one is not


def test_a_session_is_known_by_its_secret_alone() -> None:
    sessions = Sessions(FakeClock(S))
    secret = sessions.begin("ana")
    assert sessions.name_of(secret) == "ana"
    assert sessions.name_of("") is None
    assert sessions.name_of(secret[:-1]) is None
    assert sessions.name_of("\ud800") is None
    sessions.end(secret)
    sessions.end(secret)
    assert sessions.name_of(secret) is None


def test_sessions_end_by_idleness_and_at_last_by_the_clock_nobody_sets() -> None:
    clock = FakeClock(S)
    sessions = Sessions(clock)
    idle, busy = sessions.begin("ana"), sessions.begin("ana")
    clock.now_ns += round((IDLE_S - 1) * S)
    assert sessions.name_of(busy) == "ana"
    clock.now_ns += 2 * S
    assert sessions.name_of(idle) is None
    while clock.now_ns < MAX_SESSION_S * S:
        assert sessions.name_of(busy) == "ana"
        clock.now_ns += round(IDLE_S / 2 * S)
    clock.now_ns += round(IDLE_S / 2 * S)
    assert sessions.name_of(busy) is None
    assert len(sessions) == 0


def test_of_too_many_sessions_the_one_longest_unused_ends() -> None:
    clock = FakeClock(S)
    sessions = Sessions(clock)
    secrets = [sessions.begin(f"n{number}") for number in range(MAX_SESSIONS)]
    assert sessions.name_of(secrets[0]) == "n0"
    sessions.begin("new")
    assert len(sessions) == MAX_SESSIONS
    assert sessions.name_of(secrets[1]) is None
    assert sessions.name_of(secrets[0]) == "n0"
