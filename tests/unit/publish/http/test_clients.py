"""Clients: by which addresses and names they connect, how much they may ask for, their sessions."""

import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.clock import FakeClock

from altd.publish.http.clients import IDLE_S, MAX_SESSION_S, MAX_SESSIONS, Allowed, OwnNames, Sessions
from altd.tcp_port import MAX_KEYS, Buckets, Rate


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("10.1.2.3", True),
        ("::ffff:10.1.2.3", True),
        ("11.0.0.1", False),
        ("::ffff:11.0.0.1", False),
        ("192.168.7.9", True),
        ("192.168.7.10", False),
        ("fd00::17", True),
        ("fe80::1%eth0", False),
        ("2001:db8::1", False),
        ("::10.1.2.3", False),
        ("127.0.0.1", True),
        ("127.8.8.8", True),
        ("::1", True),
        ("::ffff:127.0.0.1", True),
        ("", False),
        ("unit.local", False),
    ],
)
def test_who_may_connect(host: str, expected: bool) -> None:
    assert (host in Allowed(["10.0.0.0/8", "192.168.7.9", "fd00::/8"])) is expected


@pytest.mark.parametrize("host", ["8.8.8.8", "fe80::1%eth0", "::1"])
def test_without_networks_everybody_may(host: str) -> None:
    assert host in Allowed([])


def test_a_wide_network_of_one_kind_lets_in_none_of_the_other() -> None:
    assert "::1:2" not in Allowed(["0.0.0.0/0"])
    assert "8.8.8.8" not in Allowed(["::/0"])
    assert "8.8.8.8" in Allowed(["0.0.0.0/0"])


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("192.0.2.7", True),
        ("192.0.2.7:8080", True),
        ("[2001:db8::7]:8080", True),
        ("localhost:8080", True),
        ("Unit-7:8080", True),
        ("unit-7.local", True),
        ("unit-7.plant.example.:8080", True),
        ("ALT.plant", True),
        ("", True),
        ("evil.example", False),
        ("unit-7.evil.example", False),
        ("localhost.evil.example", False),
        ("192.0.2.7.evil.example", False),
        ("[evil.example]", False),
    ],
)
def test_the_unit_is_asked_by_its_own_names(
    monkeypatch: pytest.MonkeyPatch, header: str, expected: bool
) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: "unit-7.plant.example")
    assert (header in OwnNames(["alt.plant"])) is expected


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
