"""Which Modbus TCP connection makes room: the policy alone, with times handed in."""

import random
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import count

import pytest

from altd.publish.modbus.places import (
    FIRST_REQUEST_S,
    MAX_REMEMBERED,
    QUIET_S,
    Addresses,
    Asking,
    Connection,
    connection_to_displace,
)

PLACES = 32
NOW_S = 100_000.0


@cache
def asking(since_s: float, until_s: float, gap_s: float) -> Asking:
    """Requests every ``gap_s`` between two times."""
    asked = Asking()
    for number in count():
        if (at_s := since_s + number * gap_s) > until_s:
            return asked
        asked.ask(at_s)
    raise AssertionError


def connection(
    address: str, asks_since_s: float | None = None, *, gap_s: float = 1.0, quiet_s: float = 0.0, **more: bool
) -> Connection:
    """One that has asked every ``gap_s`` from then until ``quiet_s`` ago; None: it has never asked."""
    since_s = NOW_S - (quiet_s if asks_since_s is None else asks_since_s)
    asked = Asking() if asks_since_s is None else asking(since_s, NOW_S - quiet_s, gap_s)
    return Connection(address, since_s, replace(asked), itself=replace(asked), **more)


def crowd(count: int, asks_since_s: float | None, **more: float) -> list[Connection]:
    return [connection(f"10.0.0.{number}", asks_since_s, **more) for number in range(count)]


CONTROLLER = "192.168.1.10"


def displaced(present: list[Connection], newcomer: Connection, now_s: float) -> Connection:
    """The connection that makes room; the new one takes its place."""
    found = connection_to_displace(present, newcomer, now_s)
    assert found is not None
    present[present.index(found)] = newcomer
    return found


@pytest.mark.parametrize(
    ("controller", "others"),
    [
        (connection(CONTROLLER, 60.0), crowd(31, 0.0)),
        (connection(CONTROLLER, 60.0, quiet_s=0.9), crowd(31, 50.0, gap_s=0.1)),
        (connection(CONTROLLER, 60.9, quiet_s=0.85), crowd(31, 60.5, gap_s=0.1)),
        (connection(CONTROLLER, 60.0), crowd(31, None)),
        (connection(CONTROLLER, 60.0), crowd(23, 3600.0) + crowd(8, 1.0)),
        (connection(CONTROLLER, 64 * 55.0 + 54.0, gap_s=55.0, quiet_s=54.0), crowd(31, 600.0, gap_s=0.1)),
        (connection(CONTROLLER, 60.0), crowd(31, 3600.0, quiet_s=QUIET_S + 1)),
        (connection(CONTROLLER, 60.0), [connection("10.0.0.1", 3600.0) for _ in range(31)]),
        (connection(CONTROLLER, is_reserved=True), crowd(31, 3600.0)),
        (connection(CONTROLLER, quiet_s=600.0, is_reserved=True), crowd(31, 3600.0)),
    ],
    ids=[
        "others asked once",
        "all others ask, too, and faster",
        "all others ask ten times as often, since half a second later",
        "others never ask",
        "23 have asked for longer",
        "it asks once a minute",
        "others asked for longer and are quiet",
        "one address has 31 that have asked for longer",
        "its place is reserved",
        "its place is reserved and it does not ask",
    ],
)
def test_a_controller_keeps_its_place(controller: Connection, others: list[Connection]) -> None:
    """Whichever comes, as often as all places are filled."""
    present = [controller, *others]
    random.Random(1).shuffle(present)
    for number in range(100):
        now_s = NOW_S + number * 1e-4
        newcomer = Connection(f"172.16.0.{number}", now_s, Asking())
        assert displaced(present, newcomer, now_s) is not controller
        newcomer.ask(now_s)


@pytest.mark.parametrize(
    ("present", "address"),
    [
        ([*crowd(31, None), connection("first", quiet_s=2.0)], "first"),
        ([*crowd(28, 3600.0), *(connection("many", 60.0 + i) for i in range(4))], "many"),
        ([*crowd(30, 3600.0), connection("quiet", 7200.0, quiet_s=QUIET_S + 1), connection("new")], "quiet"),
        (
            [*crowd(30, 3600.0), connection("silent", quiet_s=FIRST_REQUEST_S + 1), connection("new")],
            "silent",
        ),
        ([*crowd(31, 3600.0), connection("reserved", is_reserved=True)], "10.0.0.24"),
    ],
    ids=["the first that came", "of most connections", "quiet", "never asked", "not the reserved one"],
)
def test_of_the_others_one_makes_room(present: list[Connection], address: str) -> None:
    assert displaced(present, connection("coming"), NOW_S).address == address


def test_a_new_connection_has_time_to_ask_while_many_come() -> None:
    """A quarter of the places changes hands before it has to go."""
    present = crowd(31, 0.0)
    mine = Connection(CONTROLLER, NOW_S, Asking())
    present.append(mine)
    for number in range(PLACES // 4):
        assert mine in present, number
        now_s = NOW_S + (number + 1) * 1e-3
        newcomer = Connection(f"172.16.0.{number}", now_s, Asking())
        displaced(present, newcomer, now_s)
        newcomer.ask(now_s)


def test_of_one_address_the_connection_that_has_asked_for_longest_stays() -> None:
    """A controller and a hostile host behind the same router."""
    controller = connection(CONTROLLER, 60.0)
    hostile = [connection(CONTROLLER, 30.0, gap_s=0.1) for _ in range(31)]
    for each in hostile:
        each.of_address = controller.of_address
    assert displaced([*hostile, controller], connection(CONTROLLER), NOW_S) is not controller


def test_a_controller_that_connects_for_each_poll_is_not_new_each_time() -> None:
    addresses = Addresses()
    for poll in range(60):
        Connection(CONTROLLER, NOW_S - 60 + poll, addresses.asking(CONTROLLER)).ask(NOW_S - 60 + poll)
    again = Connection(CONTROLLER, NOW_S, addresses.asking(CONTROLLER))
    present = [again, *crowd(31, 30.0)]
    for number in range(100):
        assert displaced(present, Connection(f"172.16.0.{number}", NOW_S, Asking()), NOW_S) is not again


@pytest.mark.parametrize(
    ("present", "is_reserved", "gets_a_place"),
    [
        (crowd(3, 60.0), False, False),
        (crowd(3, 60.0), True, True),
        ([connection(f"r{number}", 60.0, is_reserved=True) for number in range(PLACES)], False, False),
        ([connection(f"r{number}", 60.0, is_reserved=True) for number in range(PLACES)], True, True),
        ([], False, False),
        ([], True, False),
    ],
    ids=[
        "few descriptors, all ask",
        "few descriptors, all ask, and it is reserved",
        "all are reserved",
        "all are reserved and so is it",
        "no descriptor at all",
        "no descriptor at all, and it is reserved",
    ],
)
def test_where_none_can_make_room_the_new_one_is_refused(
    present: list[Connection], is_reserved: bool, gets_a_place: bool
) -> None:
    newcomer = connection("coming", is_reserved=is_reserved)
    assert (connection_to_displace(present, newcomer, NOW_S) is not None) is gets_a_place


@pytest.mark.parametrize(
    "ask", [lambda asking: None, lambda asking: asking.ask(NOW_S)], ids=["mute", "asking"]
)
def test_a_flood_of_addresses_takes_no_memory_and_nothing_from_a_controller(
    ask: Callable[[Asking], None],
) -> None:
    addresses = Addresses()
    for poll in range(60):
        addresses.asking(CONTROLLER).ask(NOW_S - 60 + poll)
    for number in range(20 * MAX_REMEMBERED):
        ask(addresses.asking(f"10.{number >> 16}.{number >> 8 & 255}.{number & 255}"))
    assert len(addresses) <= 2 * MAX_REMEMBERED
    assert addresses.asking(CONTROLLER).total_s == 59.0


def test_no_gap_between_two_requests_counts_for_more_than_a_minute() -> None:
    asking = Asking()
    for time_s in (0.0, 1.0, 100_000.0):
        asking.ask(time_s)
    assert asking.total_s == 1.0 + QUIET_S
