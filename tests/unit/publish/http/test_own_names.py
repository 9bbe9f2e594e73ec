"""A page of elsewhere whose name was bent to the unit's address (DNS rebinding) reads nothing."""

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from altd.publish.http.paths import PATHS
from altd.status.health import Health

from .conftest import Unit

BENT = {"Host": "evil.example:8080", "Origin": "http://evil.example:8080"}


@pytest.mark.parametrize("path", sorted({path.path for path in PATHS} - {"/healthz"}))
async def test_no_path_is_answered_by_another_name(unit: Unit, health: Health, path: str) -> None:
    answer = await unit.ask(path, headers=BENT)
    assert answer.status == 421
    assert list(answer.json) == ["error"]
    assert health.component("http").counters["requests_misdirected"] == 1


async def test_a_browser_gets_a_page_that_names_the_setting(unit: Unit) -> None:
    browser = {"Host": "alt-7<b>.example:8080", "Accept": "text/html,*/*;q=0.8"}
    answer = await unit.ask("/", headers=browser)
    page = answer.body.decode()
    assert f'<a href="http://127.0.0.1:{unit.port}/">' in page
    json_answer = await unit.ask("/", headers=BENT)
    assert (answer.status, answer.headers["content-type"]) == (421, "text/html; charset=utf-8")
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert "[http]\nnames = [&quot;alt-7&lt;b&gt;.example&quot;]" in page
    assert "<b>" not in page
    assert "the name 'evil.example' in Host" in json_answer.json["error"]
    assert "`names` in [http]" in json_answer.json["error"]


async def test_nor_are_pictures(unit: Unit) -> None:
    headers = {"Origin": f"http://evil.example:{unit.port}"}
    with pytest.raises(InvalidStatus) as refused:
        async with connect(
            f"ws://evil.example:{unit.port}/api/v1/pictures",
            host="127.0.0.1",
            port=unit.port,
            additional_headers=headers,
            open_timeout=60,
        ):
            pass
    assert refused.value.response.status_code == 421


@pytest.mark.parametrize("host", ["127.0.0.1", "[::1]:80", "localhost:8080", "unit", "alt-0007.plant:8080"])
async def test_its_own_names_are_answered(unit: Unit, host: str) -> None:
    assert (await unit.ask("/api/status", headers={"Host": host})).status == 200


async def test_whether_anybody_is_there_may_be_asked_by_any_name(unit: Unit) -> None:
    assert (await unit.ask("/healthz", headers=BENT)).status == 200
