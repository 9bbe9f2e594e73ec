"""What each path answers, over real sockets."""

from __future__ import annotations

import asyncio
import json
import urllib.request

import pytest
from support.clock import FakeClock
from support.measurements import changed

from altd.publish.http.publisher import PATHS
from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.status.board import Board
from altd.status.health import Component, Health, State
from altd.status.measurement_json import as_object

from .conftest import Served


async def test_the_measurement_is_the_object_of_replay(
    served: Served, board: Board, measured: Measurement
) -> None:
    board.publish(measured)
    async with served() as unit:
        answer = await unit.ask("/api/measurement")
    assert answer.status == 200
    assert answer.json == as_object(measured)


async def test_a_foreign_client_reads_it(served: Served, board: Board, measured: Measurement) -> None:
    board.publish(measured)
    async with served() as unit:

        def fetch() -> object:
            with urllib.request.urlopen(f"http://127.0.0.1:{unit.port}/api/measurement", timeout=3) as answer:
                return json.load(answer)

        assert await asyncio.to_thread(fetch) == as_object(measured)


async def test_before_the_first_measurement_it_says_why_there_is_none(served: Served) -> None:
    async with served() as unit:
        answer = await unit.ask("/api/measurement")
    assert answer.status == 503
    assert answer.json["status"] == ["warming_up"]
    assert "nothing was measured" in answer.json["error"]


async def test_an_invalid_measurement_is_an_answer_without_numbers(
    served: Served, board: Board, measured: Measurement
) -> None:
    board.publish(changed(measured, None, status=(Fault(Reason.SPOT_MISSING, "front"),)))
    async with served() as unit:
        answer = await unit.ask("/api/measurement")
    assert answer.status == 200
    assert (answer.json["valid"], answer.json["x_mm"]) == (False, None)
    assert answer.json["status"] == ["front_spot_missing"]


async def test_an_old_measurement_is_stale(
    served: Served, board: Board, clock: FakeClock, measured: Measurement
) -> None:
    board.publish(measured)
    clock.now_ns += 1_100_000_000
    async with served() as unit:
        answer = await unit.ask("/api/measurement")
    assert (answer.json["valid"], answer.json["status"]) == (False, ["stale"])


async def test_the_status_is_the_health_of_the_unit(served: Served, health: Health) -> None:
    health.component("camera front").say(State.FAILED, "no such device")
    async with served() as unit:
        answer = await unit.ask("/api/status")
    assert answer.status == 200
    assert answer.json["serial"] == "ALT-0007"
    assert answer.json["components"]["camera front"]["message"] == "no such device"
    assert answer.json["components"]["http"]["state"] == "ok"


async def test_the_page_needs_nothing_from_elsewhere(served: Served) -> None:
    async with served() as unit:
        answer = await unit.ask("/")
    page = answer.body.decode()
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert "://" not in page
    assert "src=" not in page
    for path in PATHS[1:]:
        assert f'href="{path.path}"' in page


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nothing", 404),
        ("GET", "/api/status/", 404),
        ("GET", "/../../etc/passwd", 404),
        ("GET", "/%00%ff", 404),
        ("POST", "/api/measurement", 405),
        ("DELETE", "/api/stream", 405),
        ("OPTIONS", "/api/status", 405),
    ],
)
async def test_refusals_are_json(served: Served, method: str, path: str, status: int) -> None:
    async with served() as unit:
        answer = await unit.ask(path, method)
    assert answer.status == status
    assert set(answer.json) == {"error"}


@pytest.mark.parametrize("path", [path.path for path in PATHS])
async def test_head_has_the_headers_and_no_body(
    served: Served, board: Board, measured: Measurement, path: str
) -> None:
    board.publish(measured)
    async with served() as unit:
        answer = await unit.ask(path, "HEAD")
    assert (answer.status, answer.body) == (200, b"")


@pytest.mark.parametrize("path", ["/", "/api/measurement", "/api/status", "/nothing"])
async def test_no_answer_is_kept_by_caches_or_given_to_other_sites(served: Served, path: str) -> None:
    async with served() as unit:
        answer = await unit.ask(path)
    assert answer.headers["cache-control"] == "no-store"
    assert not any(name.startswith("access-control") for name in answer.headers)
    assert "server" not in answer.headers


async def test_requests_are_counted(served: Served, component: Component) -> None:
    async with served() as unit:
        for _ in range(3):
            await unit.ask("/api/status")
    assert component.counters["requests"] == 3
    assert component.state is State.OK


async def test_only_a_measurement_is_data(
    served: Served, board: Board, measured: Measurement, component: Component
) -> None:
    async with served() as unit:
        for path in ("/", "/api/status", "/api/measurement"):
            await unit.ask(path)
        assert component.data_given == 0  # nothing was measured yet
        board.publish(measured)
        await unit.ask("/api/measurement")
    assert component.data_given == 1
