"""The self-check over HTTP: who may ask for one, and what comes back."""

import asyncio
import json

import pytest
from starlette.requests import Request
from support.clock import FakeClock
from support.status_fixtures import checked

from altd.publish.http.answers import self_check
from altd.publish.http.clients import MAX_WAITING
from altd.publish.http.errors import Refused
from altd.publish.http.guard import Guard
from altd.status.unit import PublishedUnit

from .conftest import Answer, Unit


async def post(unit: Unit, host: str = "127.0.0.1:80", header: str = "X-Altd-Request: 1\r\n") -> Answer:
    raw = f"POST /api/self-check HTTP/1.1\r\nHost: {host}\r\n{header}Content-Length: 0\r\n\r\n"
    return Answer.of(await unit.send(raw.encode("latin-1")))


async def test_before_the_first_check_says_so(unit: Unit, published: PublishedUnit) -> None:
    without = (await unit.ask("/api/self-check")).json
    published.self_check.open(lambda: None)
    before = (await unit.ask("/api/self-check")).json
    why = "this unit has no frame LEDs that the daemon switches"
    assert without == {"verdict": None, "reasons": [why], "unavailable": why}
    why = "there was no self-check since the unit started"
    assert before == {"verdict": None, "reasons": [why], "unavailable": ""}


async def test_who_asks_gets_what_a_check_says_that_began_afterwards(
    unit: Unit, published: PublishedUnit
) -> None:
    service = published.self_check
    asked = asyncio.Event()
    service.open(asked.set)
    assert service.begin() == 1
    answering = asyncio.create_task(post(unit))
    await asyncio.wait_for(asked.wait(), 60)
    service.publish(checked(1))  # it was under way before it was asked for
    await asyncio.sleep(0.05)
    assert not answering.done()
    service.publish(checked(service.begin()))
    answer = await answering
    assert (answer.status, answer.json["number"]) == (200, 2)


async def test_a_unit_that_cannot_check_itself_says_why(unit: Unit) -> None:
    answer = await post(unit)
    assert answer.status == 409
    assert "no frame LEDs" in answer.json["error"]


@pytest.mark.parametrize(
    ("host", "header"),
    [
        pytest.param("127.0.0.1:80", "", id="a page of another site"),
        pytest.param("evil.example:80", "X-Altd-Request: 1\r\n", id="a name that was bent to the unit"),
        pytest.param("[::1", "", id="no address"),
        *(
            pytest.param(host, "X-Altd-Request: 1\r\n", id=host)
            for host in (
                "localhost.evil",
                "127.0.0.1.evil:80",
                "127.1",
                "2130706433",
                "evil@127.0.0.1",
                "a b",
            )
        ),
        *(
            pytest.param("127.0.0.1:80", f"X-Altd-Request: 1\r\nOrigin: {origin}\r\n", id=f"origin {origin}")
            for origin in ("http://evil.example", "null", "http://127.0.0.1:81", "https://127.0.0.1:80", "")
        ),
        pytest.param(
            "127.0.0.1:80",
            "Content-Type: application/x-www-form-urlencoded\r\nOrigin: http://evil.example\r\n",
            id="a form of another site",
        ),
    ],
)
async def test_a_browser_on_the_unit_is_not_made_to_ask(
    unit: Unit, published: PublishedUnit, host: str, header: str
) -> None:
    published.self_check.open(lambda: pytest.fail("it was asked for"))
    answer = await post(unit, host, header)
    assert answer.status in (400, 403, 421)  # 400: by no name; 421: by a name that is not the unit's
    assert set(answer.json) == {"error"}


@pytest.mark.parametrize("client", ["192.0.2.7", "::ffff:192.0.2.7", "fe80::1"])
async def test_another_computer_may_not_ask(published: PublishedUnit, client: str) -> None:
    published.self_check.open(lambda: pytest.fail("it was asked for"))
    scope = {
        "type": "http",
        "method": "POST",
        "path": "/api/self-check",
        "headers": [(b"host", b"10.0.0.2"), (b"x-altd-request", b"1")],
        "client": (client, 4000),
        "server": ("10.0.0.2", 8080),
    }
    guard = Guard(None, FakeClock())
    with pytest.raises(Refused) as refused:
        await self_check(Request(scope), published.self_check, guard)
    answer = refused.value.answer
    said = {"error": "only the unit's own computer may ask for this: [http] credentials is not set"}
    assert (answer.status_code, json.loads(answer.body)) == (403, said)


async def sent(unit: Unit, raw: str) -> list[str]:
    """The first lines of all answers to what is sent on one connection."""
    answers = (await unit.send(raw.encode("latin-1"))).decode("latin-1")
    return [line for line in answers.split("\r\n") if line.startswith("HTTP/")]


ASKING = "POST /api/self-check HTTP/1.1\r\nHost: 127.0.0.1:80\r\nX-Altd-Request: 1\r\n"


@pytest.mark.parametrize(
    "rest",
    [
        pytest.param(f"Content-Length: 100000000\r\n\r\n{'x' * 1_000_000}", id="a big body that never ends"),
        pytest.param("Content-Type: image/png\r\nContent-Length: 4\r\n\r\n\x89PNG", id="a picture"),
        pytest.param("Content-Type: application/json\r\nContent-Length: 3\r\n\r\n{{{", id="no JSON"),
        pytest.param("Content-Length: 0\r\n\r\n" + ASKING + "Content-Length: 0\r\n\r\n", id="two at once"),
        pytest.param("Origin: http://127.0.0.1:80\r\nContent-Length: 0\r\n\r\n", id="the unit's own page"),
    ],
)
async def test_what_comes_with_a_request_changes_nothing_of_it(
    unit: Unit, checked: list[int], rest: str
) -> None:
    assert await sent(unit, ASKING + rest) in (["HTTP/1.1 200 OK"], [])  # []: cut off while it still sends
    assert len(checked) == 1
    assert (await unit.ask("/api/self-check")).json["number"] == 1


async def test_a_flood_leaves_room_for_who_reads_and_is_one_check(
    unit: Unit, published: PublishedUnit
) -> None:
    service, asked = published.self_check, list[bool]()
    service.open(lambda: asked.append(True))
    flood = [asyncio.create_task(post(unit)) for _ in range(40)]
    await unit.until(lambda: sum(task.done() for task in flood) == 40 - MAX_WAITING)
    assert {task.result().status for task in flood if task.done()} == {503}
    assert len(asked) == MAX_WAITING  # the schedule makes one check of them
    assert (await unit.ask("/api/status")).status == 200
    service.publish(checked(service.begin()))
    statuses = [answer.status for answer in await asyncio.gather(*flood)]
    assert sorted(statuses) == [200] * MAX_WAITING + [503] * (40 - MAX_WAITING)
    again = asyncio.create_task(post(unit))
    await unit.until(lambda: len(asked) == MAX_WAITING + 1)
    service.publish(checked(service.begin()))
    assert (await again).status == 200
