"""Events of logging in: the name and the address, never the typed text."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from support.clock import FakeClock

from altd.publish.http.clients import ATTEMPTS
from altd.status.event_log import MAX_OF_ONE_IN_WINDOW, WINDOW_S, Event, EventKind, EventLog

from .conftest import OURS, PASSWORD, TOKEN, Served, Unit, check, cookie_of, log_in


@pytest.fixture
async def unit(served: Served, credentials: Path) -> AsyncIterator[Unit]:
    async with served(credentials=credentials) as unit:
        yield unit


def told(events: list[Event]) -> list[tuple[str | None, str]]:
    assert {event.kind for event in events} <= {EventKind.REQUEST}
    return [(event.of, event.text) for event in events]


async def test_who_logs_in_and_out_is_an_event_with_name_and_address(unit: Unit, events: EventLog) -> None:
    cookie = cookie_of(await log_in(unit))
    for _ in range(2):  # the second one has no session any more
        await unit.ask("/api/v1/logout", "POST", {**OURS, "Cookie": cookie})
    await unit.ask("/api/v1/logout", "POST", OURS)
    noted = events.after(0)
    assert told(noted) == [("ana", "logged in, from 127.0.0.1"), ("ana", "logged out, from 127.0.0.1")]
    assert [event.detail["address"] for event in noted] == ["127.0.0.1"] * 2


@pytest.mark.parametrize(
    ("name", "password", "noted"),
    [
        ("ana", "open sesamy", ("ana", "a wrong password, from 127.0.0.1")),
        (PASSWORD, "", (None, "a wrong name or password, from 127.0.0.1")),
        ("Ana", PASSWORD, (None, "a wrong name or password, from 127.0.0.1")),
    ],
    ids=["a wrong password", "the password as the name", "a wrong name"],
)
async def test_a_wrong_attempt_is_an_event_without_what_was_typed(
    unit: Unit, events: EventLog, name: str, password: str, noted: tuple[str | None, str]
) -> None:
    assert (await log_in(unit, name, password)).status == 401
    assert told(events.after(0)) == [noted]
    assert PASSWORD not in repr(events.after(0))
    assert "open sesamy" not in repr(events.after(0))


async def test_a_wrong_token_is_an_event_and_a_session_that_is_over_is_none(
    unit: Unit, events: EventLog, checked: list[int]
) -> None:
    assert (await check(unit, Authorization=f"Bearer {TOKEN}x")).status == 401
    assert (await check(unit, Cookie=f"altd_{unit.port}=of-before-the-restart")).status == 401
    assert told(events.after(0)) == [(None, "a wrong token, from 127.0.0.1")]
    assert TOKEN not in repr(events.after(0))
    assert checked == []


async def test_who_tries_again_and_again_is_counted_and_hides_nobody(
    unit: Unit, clock: FakeClock, events: EventLog
) -> None:
    tries = 3 * MAX_OF_ONE_IN_WINDOW
    for _ in range(tries):
        await log_in(unit, "nobody", "guess")
    clock.now_ns += 10_000_000_000
    await log_in(unit)
    noted = events.after(0)
    clock.now_ns += round(WINDOW_S * 1e9)
    events.release(clock.now_ns)
    later = events.after(noted[-1].number)
    wrong, many = "a wrong name or password, from 127.0.0.1", "too many wrong attempts, from 127.0.0.1"
    limited = [(None, many)] * MAX_OF_ONE_IN_WINDOW
    assert told(noted) == [*[(None, wrong)] * ATTEMPTS.burst, *limited, ("ana", "logged in, from 127.0.0.1")]
    assert told(later) == [(None, many)]
    assert later[0].held_back == tries - ATTEMPTS.burst - MAX_OF_ONE_IN_WINDOW - 1
