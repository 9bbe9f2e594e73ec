"""The same answers on the local socket: with what a network's client may not, and bounds of its own."""

import asyncio
import contextlib
import errno
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest
from support.clock import FakeClock, stop
from support.serving import serving
from support.status_fixtures import checked

from altd.local_socket import ask
from altd.publish.http import publisher, server
from altd.publish.http.paths import PATHS
from altd.publish.http.publisher import LocalPublisher
from altd.records import Measurement
from altd.runtime.supervision import keep_running
from altd.status.board import Board
from altd.status.health import Health, State
from altd.status.unit import PublishedUnit

from .conftest import NEED_MORE, Unit

HEADERS = {"X-Altd-Request": "1"}


@contextlib.asynccontextmanager
async def served_at(path: Path, published: PublishedUnit) -> AsyncIterator[LocalPublisher]:
    publisher = LocalPublisher(path, published, published.health.component("local"))
    async with serving(publisher):
        yield publisher


@pytest.fixture
async def path(tmp_path: Path, published: PublishedUnit) -> AsyncIterator[Path]:
    async with served_at(tmp_path / "altd.sock", published):
        yield tmp_path / "altd.sock"


NOT_JSON = "/", "/reasons", "/stream", "/metrics", "/diagnostics", "}"
"""Pages, streams, numbers for Prometheus, and what needs a name."""


async def said(path: Path, target: str, method: str = "GET") -> tuple[int, dict[str, object]]:
    return await asyncio.to_thread(ask, path, target, 5.0, method, HEADERS)


async def test_every_path_of_the_network_is_answered_alike(
    unit: Unit, path: Path, board: Board, measured: Measurement
) -> None:
    board.publish(measured)
    own = {"message", "crc32", "may_act"}
    paths = [each.path for each in PATHS if "GET" in each.operations]
    for target in (each for each in paths if not each.endswith(NOT_JSON)):
        (status, local), network = await said(path, target), (await unit.ask(target))
        assert status == network.status == (503 if target in NEED_MORE else 200)
        if "components" not in local:
            assert {key: local[key] for key in local.keys() - own} == {
                key: network.json[key] for key in network.json.keys() - own
            }


async def test_who_may_open_the_file_may_ask_for_a_check(path: Path, published: PublishedUnit) -> None:
    service, loop = published.self_check, asyncio.get_running_loop()

    def make() -> None:
        service.publish(checked(service.begin()))

    service.open(lambda: loop.call_soon(make) and None)
    status, report = await said(path, "/api/self-check", "POST")
    assert (status, report["verdict"]) == (200, "good")
    assert (await said(path, "/api/v1/session"))[1]["may_act"] is True


async def test_health_says_for_whom_it_is(path: Path, health: Health) -> None:
    component = health.component("local")
    assert (component.state, component.message) == (State.OK, "for this computer only")


async def test_its_file_is_gone_with_it_and_a_second_one_is_refused(
    tmp_path: Path, board: Board, published: PublishedUnit, health: Health
) -> None:
    path = tmp_path / "altd.sock"
    async with served_at(path, published):
        second = LocalPublisher(path, published, health.component("second"))
        with pytest.raises(OSError, match="another process listens there") as caught:
            await second.run(lambda: pytest.fail("ready"))
        assert caught.value.errno == errno.EADDRINUSE
        assert (await said(path, "/api/status"))[0] == 200
    assert not path.exists()


@pytest.mark.parametrize("by", ["nothing", "a socket", "a file", "a folder"])
async def test_one_whose_file_is_deleted_or_replaced_says_so_and_serves_again(
    tmp_path: Path, published: PublishedUnit, health: Health, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    monkeypatch.setattr(publisher, "_LOOK_INTERVAL_S", 0.01)
    path, component, clock = tmp_path / "s", health.component("local"), FakeClock()
    face = asyncio.create_task(
        keep_running("local", LocalPublisher(path, published, component), component, clock)
    )
    await until(lambda: component.state is State.OK)
    path.unlink()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(tmp_path / "dead"))
    {"a socket": lambda: (tmp_path / "dead").rename(path), "a file": path.touch, "a folder": path.mkdir}.get(
        by, lambda: None
    )()
    await until(lambda: component.state is State.FAILED)
    assert component.message.startswith("the file of the socket was deleted or replaced; next try in")
    if by in ("a file", "a folder"):
        await clock.advance(1.0)
        assert "the file is not a socket" in component.message
        assert path.exists()
        path.unlink() if by == "a file" else path.rmdir()
    await clock.advance(1.0)
    await until(lambda: component.state is State.OK)
    assert (await said(path, "/api/v1/session"))[0] == 200
    await stop(face)
    assert not path.exists()


async def until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(60):
        while not true():  # noqa: ASYNC110  a real file, not this clock
            await asyncio.sleep(0.002)


async def test_who_never_reads_is_cut_off_as_on_the_network(
    path: Path, board: Board, measured: Measurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stream that is not read: the kernel ends it on TCP, here the server does."""
    monkeypatch.setattr(server, "SEND_TIMEOUT_S", 0.2)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.setblocking(False)
        await asyncio.get_running_loop().sock_connect(client, str(path))
        await asyncio.get_running_loop().sock_sendall(client, b"GET /api/stream HTTP/1.1\r\nHost: a\r\n\r\n")
        async with asyncio.timeout(60):
            with contextlib.suppress(BrokenPipeError):
                while True:
                    board.publish(measured)
                    await asyncio.sleep(0.002)
                    client.send(b"x")


async def test_a_flood_leaves_the_network_its_connections(unit: Unit, path: Path) -> None:
    loop = asyncio.get_running_loop()
    with contextlib.ExitStack() as clients:
        for _ in range(server.MAX_CONNECTIONS + 10):
            client = clients.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            client.setblocking(False)
            await loop.sock_connect(client, str(path))
        await asyncio.sleep(0.1)
        assert (await unit.ask("/api/status")).status == 200
    assert (await said(path, "/api/status"))[0] == 200
