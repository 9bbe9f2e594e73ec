"""Permission to act where credentials are set: tokens, sessions, other pages, and too many tries."""

import json
import logging
from collections.abc import AsyncIterator, Sequence
from pathlib import Path

import pytest
from starlette.requests import HTTPConnection
from support.clock import FakeClock
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from altd.credentials.file import change
from altd.credentials.hashes import PasswordHash
from altd.publish.http.clients import ALL_ATTEMPTS, ATTEMPTS, MAX_FAMILIAR
from altd.publish.http.errors import Refused
from altd.publish.http.guard import Guard
from altd.status.health import Component, State
from altd.status.services import Picture, TargetView
from altd.status.unit import PublishedUnit

from .conftest import OURS, PASSWORD, TOKEN, Served, Unit, check, cookie_of, log_in


@pytest.fixture
async def unit(served: Served, credentials: Path) -> AsyncIterator[Unit]:
    async with served(credentials=credentials) as unit:
        yield unit


def _chmod(path: Path, mode: int) -> None:
    path.chmod(mode)


async def test_a_token_may_act_and_a_wrong_one_may_not(unit: Unit, checked: list[int]) -> None:
    assert (await check(unit)).status == 401
    assert (await check(unit, Authorization=f"Bearer {TOKEN}")).status == 200
    assert (await check(unit, Authorization=f"bearer {TOKEN}")).status == 200
    assert (await check(unit, Authorization=f"Basic {TOKEN}")).status == 401
    assert len(checked) == 2


@pytest.mark.parametrize(
    "wrong", [TOKEN[:-1], f"{TOKEN}x", "", PASSWORD, "\xe9" * 43, f"{TOKEN} {TOKEN}", "x" * 4000]
)
async def test_no_other_text_is_the_token(unit: Unit, checked: list[int], wrong: str) -> None:
    answer = await check(unit, Authorization=f"Bearer {wrong}")
    assert (answer.status, answer.headers["www-authenticate"]) == (401, 'Bearer realm="altd"')
    assert checked == []


async def test_a_token_in_the_url_is_none(unit: Unit, checked: list[int]) -> None:
    for query in (f"?token={TOKEN}", f"?access_token={TOKEN}", f"?Authorization=Bearer+{TOKEN}"):
        answer = await unit.ask(f"/api/v1/self-check{query}", "POST", OURS)
        assert answer.status == 401
    assert checked == []


async def test_who_logs_in_may_act_until_he_logs_out(unit: Unit, checked: list[int]) -> None:
    before = (await unit.ask("/api/v1/session")).json
    answer = await log_in(unit)
    cookie = cookie_of(answer)
    during = (await unit.ask("/api/v1/session", headers={"Cookie": cookie})).json
    assert (await check(unit, Cookie=cookie)).status == 200
    out = await unit.ask("/api/v1/logout", "POST", {**OURS, "Cookie": cookie})
    assert (await check(unit, Cookie=cookie)).status == 401
    assert before == {"name": None, "may_act": False, "login": True}
    assert during == answer.json == {"name": "ana", "may_act": True, "login": True}
    attributes = answer.headers["set-cookie"].split("; ")[1:]
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(attributes)
    assert "Secure" not in attributes  # without TLS a browser would not send it back
    assert cookie.startswith(f"altd_{unit.port}=")
    assert "Max-Age=0" in out.headers["set-cookie"]
    assert len(checked) == 1


@pytest.mark.parametrize(
    ("name", "password"), [("ana", "open sesamy"), ("bob", PASSWORD), ("", ""), ("press", TOKEN)]
)
async def test_a_wrong_name_or_password_begins_no_session(unit: Unit, name: str, password: str) -> None:
    answer = await log_in(unit, name, password)
    assert (answer.status, answer.json) == (401, {"error": "name or password is wrong"})
    assert "set-cookie" not in answer.headers


async def test_cookies_of_others_are_not_taken_for_ours(unit: Unit, checked: list[int]) -> None:
    cookie = cookie_of(await log_in(unit))
    name, _, secret = cookie.partition("=")
    for wrong in (
        f"altd_1={secret}",  # of another port of the same host
        f"{name}={secret}; {name}=evil",  # which of the two is ours?
        f"{name}=evil; {name}={secret}",
        f"{name}=",
        f"{name}",
        f'{name}="{secret}"',
        "; ; =;=" * 50,
    ):
        assert (await check(unit, Cookie=wrong)).status in (401, 429), wrong
    assert checked == []


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://alt-0007.plant:80"},
        {"Origin": "http://alt-0007.plant:81"},
        {"Origin": "http://alt-0007.plant:80.evil"},
        {"Origin": ""},
    ],
)
async def test_a_page_of_elsewhere_may_not_use_a_browsers_session(
    unit: Unit, checked: list[int], headers: dict[str, str]
) -> None:
    cookie = cookie_of(await log_in(unit))
    assert (await check(unit, Cookie=cookie, **headers)).status == 403
    assert (await log_in(unit, **headers)).status == 403
    out = await unit.ask("/api/v1/logout", "POST", {**OURS, "Cookie": cookie, **headers})
    assert out.status == 403
    without = await unit.ask("/api/v1/self-check", "POST", {"Host": "unit", "Cookie": cookie})
    assert without.status == 403
    own = await check(unit, Cookie=cookie, Origin="http://alt-0007.plant:80")
    assert own.status == 200
    assert len(checked) == 1


TWICE = {
    "Origin": ("http://alt-0007.plant:80", "http://evil.example"),
    "Host": (OURS["Host"], "evil.example"),
    "Authorization": (f"Bearer {TOKEN}", "Bearer another"),
    "Cookie": ("a=b", "c=d"),
    "Content-Type": ("application/json", "text/plain"),
    "Content-Length": ("2", "3"),
}


@pytest.mark.parametrize("name", TWICE)
@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("path", ["/api/v1/self-check", "/api/v1/pictures"])
async def test_a_header_of_one_value_comes_once(
    unit: Unit, checked: list[int], name: str, order: int, path: str
) -> None:
    """Whichever of two would be read, for any client: a program, or a browser for pictures."""
    headers = [("Host", OURS["Host"]), ("X-Altd-Request", "1"), ("Authorization", f"Bearer {TOKEN}")]
    if path.endswith("pictures"):
        key = "dGhlIHNhbXBsZSBub25jZQ=="
        headers += [("Upgrade", "websocket"), ("Connection", "Upgrade")]
        headers += [("Sec-WebSocket-Version", "13"), ("Sec-WebSocket-Key", key)]
    headers = [each for each in headers if each[0] != name] + [(name, text) for text in TWICE[name][::order]]
    head = "".join(f"{each}: {text}\r\n" for each, text in headers)
    method = "GET" if path.endswith("pictures") else "POST"
    answer = await unit.send(f"{method} {path} HTTP/1.1\r\n{head}\r\n{{}}".encode())
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert list(json.loads(answer.partition(b"\r\n\r\n")[2])) == ["error"]
    assert checked == []


async def test_forwarded_addresses_are_not_believed(served: Served, published: PublishedUnit) -> None:
    published.self_check.open(lambda: pytest.fail("it was asked for"))
    async with served(allow=["192.0.2.0/24"]) as unit:
        for name in ("X-Forwarded-For", "Forwarded", "X-Real-IP"):
            for value in ("127.0.0.1", "for=127.0.0.1;proto=https"):
                answer = await unit.ask("/api/v1/self-check", "POST", {**OURS, name: value})
                assert answer.status == 403  # of this computer, but bent by a name in Host


async def test_wrong_attempts_are_limited_and_time_heals(
    unit: Unit, clock: FakeClock, checked: list[int]
) -> None:
    statuses = [(await log_in(unit, "ana", f"guess number {number}")).status for number in range(8)]
    assert statuses == [401] * ATTEMPTS.burst + [429] * (8 - ATTEMPTS.burst)
    refused = await log_in(unit)
    assert refused.status == 429, "also the right one, or a guess could be told from the others"
    assert 1 <= int(refused.headers["retry-after"]) <= 10
    assert (await check(unit, Authorization=f"Bearer {TOKEN}")).status == 200, "nobody guesses a token"
    clock.now_ns += 10_000_000_000
    assert (await log_in(unit)).status == 200
    assert (await log_in(unit)).status == 200, "who knows the password is not limited"
    assert (await unit.ask("/api/v1/status")).status == 200
    assert checked == [1]


async def test_wrong_attempts_from_elsewhere_leave_those_of_who_has_logged_in(clock: FakeClock) -> None:
    """A flood of guesses from ever new addresses, and from behind the same router as one of them."""
    guard = Guard(lambda: _AnasPassword(), clock)
    users = [f"10.0.0.{number}" for number in range(MAX_FAMILIAR)] + ["2001:db8:1:2::1"]
    for user in users:
        assert await tried(guard, user, PASSWORD) == 200
    for round_ in range(3):
        guesses = [await tried(guard, f"192.0.2.{number}", f"{round_}") for number in range(200)]
        assert guesses.count(401) <= ALL_ATTEMPTS.burst
        assert await tried(guard, "192.0.2.201", PASSWORD) == 429
        assert await tried(guard, users[0], PASSWORD) == 429, "of so many addresses it was the first"
        shared = [await tried(guard, users[1], f"{number}") for number in range(200)]
        assert shared.count(401) == (ATTEMPTS.burst if round_ == 0 else 1)
        assert await tried(guard, users[1], PASSWORD) == 429
        for user in (*users[2:], "2001:db8:1:2::ffff"):
            assert [await tried(guard, user, PASSWORD) for _ in range(5)] == [200] * 5
        clock.now_ns += 10_000_000_000


class _AnasPassword:
    names = frozenset({"ana"})

    def is_password(self, name: str, password: str) -> bool:
        return (name, password) == ("ana", PASSWORD)

    def password_of(self, name: str) -> object:
        return name

    def name_of_token(self, token: str) -> str | None:
        return None


async def tried(guard: Guard, address: str, password: str) -> int:
    """The status of logging in from an address."""
    headers = [(b"x-altd-request", b"1")]
    scope = {"type": "http", "scheme": "http", "client": (address, 40_000), "headers": headers}
    try:
        await guard.log_in(HTTPConnection(scope), "ana", password)
    except Refused as refused:
        return refused.answer.status_code
    return 200


async def test_a_page_whose_session_is_over_does_not_keep_its_user_from_logging_in(
    unit: Unit, clock: FakeClock
) -> None:
    """After a restart of the daemon, or 30 minutes: the page still asks for pictures every second."""
    for _ in range(2 * ATTEMPTS.burst):
        for headers in ({"Cookie": f"altd_{unit.port}=over"}, {"Authorization": "Bearer revoked"}):
            with pytest.raises(InvalidStatus) as refused:
                await connect(f"ws://127.0.0.1:{unit.port}/api/v1/pictures", additional_headers=headers)
            assert refused.value.response.status_code == 401
        clock.now_ns += 1_000_000_000
    assert (await log_in(unit)).status == 200


async def test_who_is_taken_out_of_the_file_loses_his_session(
    unit: Unit, credentials: Path, component: Component
) -> None:
    cookie = cookie_of(await log_in(unit))
    change(credentials, "ana", lambda known: known.with_password("ana", None))
    assert (await check(unit, Cookie=cookie)).status == 401
    _chmod(credentials, 0o644)
    assert (await check(unit, Authorization=f"Bearer {TOKEN}")).status == 401
    assert component.state is State.DEGRADED
    assert "mode 0644" in component.message
    _chmod(credentials, 0o600)
    assert (await check(unit, Authorization=f"Bearer {TOKEN}")).status == 409
    assert component.state is State.OK


@pytest.mark.parametrize("is_taken_out_first", [False, True])
async def test_a_password_that_is_changed_ends_the_sessions_of_the_one_before(
    unit: Unit, credentials: Path, checked: list[int], is_taken_out_first: bool
) -> None:
    stolen = {"Cookie": cookie_of(await log_in(unit))}
    assert (await check(unit, **stolen)).status == 200
    if is_taken_out_first:
        change(credentials, "ana", lambda known: known.with_password("ana", None))
    change(credentials, "ana", lambda known: known.with_password("ana", PasswordHash.of("another one")))
    assert (await check(unit, **stolen)).status == 401
    assert (await unit.ask("/api/v1/session", headers=stolen)).json["name"] is None
    new = {"Cookie": cookie_of(await log_in(unit, password="another one"))}
    assert (await check(unit, **new)).status == 200
    assert len(checked) == 2


async def test_pictures_are_for_who_is_known_where_credentials_are_set(unit: Unit) -> None:
    url = f"ws://127.0.0.1:{unit.port}/api/v1/pictures"
    cookie = cookie_of(await log_in(unit))
    for headers in ({"Cookie": cookie}, {"Authorization": f"Bearer {TOKEN}"}):
        async with connect(url, additional_headers=headers) as browser:
            with pytest.raises(ConnectionClosed, match="1013"):  # let in; this unit makes no pictures
                await browser.recv()
    for headers in ({}, {"Cookie": f"{cookie}x"}, {"Authorization": "Bearer guess"}):
        with pytest.raises(InvalidStatus) as refused:
            await connect(url, additional_headers=headers)
        assert refused.value.response.status_code == 401


class Maker:
    """Makes no picture at once."""

    views: Sequence[TargetView] = ()

    async def newer(self, seen: dict[str, int]) -> Sequence[Picture]:
        return ()


async def test_pictures_end_with_the_session_that_they_were_shown_to(
    unit: Unit, published: PublishedUnit
) -> None:
    published.pictures.open(Maker())
    cookie = cookie_of(await log_in(unit))
    url = f"ws://127.0.0.1:{unit.port}/api/v1/pictures"
    async with connect(url, additional_headers={"Cookie": cookie}) as browser:
        assert "views" in await browser.recv()
        await browser.send("next")
        assert isinstance(await browser.recv(), bytes)
        await unit.ask("/api/v1/logout", "POST", {**OURS, "Cookie": cookie})
        await browser.send("next")
        with pytest.raises(ConnectionClosed, match="1008"):
            await browser.recv()


async def test_without_credentials_nobody_can_log_in(served: Served) -> None:
    async with served() as unit:
        assert (await log_in(unit)).status == 409
        assert (await unit.ask("/api/v1/session")).json == {"name": None, "may_act": False, "login": False}
        local = (await unit.ask("/api/v1/session", headers={"Host": "127.0.0.1"})).json
        assert local == {"name": None, "may_act": True, "login": False}


@pytest.mark.parametrize(
    ("kind", "body", "status"),
    [
        ("text/plain", b"{}", 415),
        ("application/x-www-form-urlencoded", b"name=ana&password=open+sesame", 415),
        ("application/json", b"", 400),
        ("application/json", b"{", 400),
        ("application/json", b"null", 400),
        ("application/json", b'{"name": "ana"}', 400),
        ("application/json", b'{"name": "ana", "password": 7}', 400),
        ("application/json", b'{"name": ["ana"], "password": "open sesame"}', 400),
        ("application/json", b'{"name": "ana", "password": "open sesame", "admin": true}', 400),
        ("application/json", b"[" * 4000, 400),
        ("application/json", b'{"name": "ana", "password": "' + b"x" * 5000 + b'"}', 413),
        ("application/json", b'{"name": "\xff", "password": "open sesame"}', 400),
        ("application/json", b'{"name": "\\ud800", "password": "open sesame"}', 400),
    ],
)
async def test_bodies_that_are_none(
    unit: Unit, caplog: pytest.LogCaptureFixture, kind: str, body: bytes, status: int
) -> None:
    answer = await unit.ask("/api/v1/login", "POST", {**OURS, "Content-Type": kind}, body)
    assert answer.status == status
    assert set(answer.json) == {"error"}
    assert b"sesame" not in answer.body
    assert caplog.records == []


async def test_no_secret_gets_into_the_log(
    unit: Unit, caplog: pytest.LogCaptureFixture, checked: list[int]
) -> None:
    caplog.set_level(logging.DEBUG)
    cookie = cookie_of(await log_in(unit))
    await log_in(unit, "ana", "guess number 1")
    await check(unit, Cookie=cookie)
    await check(unit, Authorization=f"Bearer {TOKEN}")
    status = await unit.ask("/api/v1/status")
    metrics = await unit.ask("/metrics")
    said = caplog.text + status.body.decode() + metrics.body.decode()
    for secret in (PASSWORD, "guess number 1", TOKEN, cookie.partition("=")[2]):
        assert secret not in said
