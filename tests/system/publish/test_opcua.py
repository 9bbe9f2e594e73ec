"""The server in its own process: foreign clients, kills and stops, and clients that vanish."""

import asyncio
import contextlib
import gc
import logging
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, BinaryIO

import pytest
from asyncua import Client, ua
from support import history as past
from support.opcua import OpcUaUnit, by_node, connected, made_certificate, read
from support.places import ROOT
from support.ports import free_port

from altd.config import OpcUaSettings
from altd.credentials.file import Credentials, save_credentials
from altd.credentials.hashes import PasswordHash
from altd.errors import BadInputError
from altd.history.history import History
from altd.publish.opcua import process as opcua_process
from altd.publish.opcua import publisher
from altd.publish.opcua.quality import Status
from altd.reasons import Reason
from altd.runtime.supervision import keep_running
from altd.status.health import State
from altd.status.measurement_json import checked_line
from altd.tcp_port import listen
from tools.pages.example import SERIAL

pytestmark = pytest.mark.real_time  # the server has a low priority

KEYS = ["x_mm", "y_mm", "yaw_deg", "pitch_deg", "targets.front.x_mm", "valid", "sequence", "age_ms", "health"]
NUMBERS = KEYS[:5]
SOON = timedelta(seconds=2.5)


@pytest.fixture(autouse=True)
def quiet() -> None:
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)


@dataclass
class Running:
    unit: OpcUaUnit
    task: asyncio.Task[None]

    @property
    def child(self) -> int:
        assert self.unit.publisher.process is not None
        return self.unit.publisher.process.pid

    async def until(self, holds: Callable[[], object], within_s: float = 150.0) -> None:
        deadline_s = time.monotonic() + within_s
        while not holds():
            component = self.unit.component
            assert time.monotonic() < deadline_s, f"{component.state}: {component.message}"
            await asyncio.sleep(0.02)

    async def serves(self) -> None:
        await self.until(lambda: self.unit.component.state is State.OK)


@contextlib.asynccontextmanager
async def running(is_measuring: bool = True, **fields: Any) -> AsyncIterator[Running]:
    """The publisher under supervision, as in the daemon, beside something that measures 20 times a second."""
    unit = OpcUaUnit(**fields)

    async def measuring() -> None:
        for sequence in range(10**9):
            unit.measure(sequence)
            await asyncio.sleep(0.05)

    task = asyncio.create_task(keep_running("opcua", unit.publisher, unit.component, unit.clock))
    measured = asyncio.create_task(measuring()) if is_measuring else task
    there = Running(unit, task)
    try:
        await there.serves()
        yield there
    finally:
        for each in {task, measured}:
            each.cancel()
        await asyncio.gather(task, measured, return_exceptions=True)
        assert not _lives(there.child), "its process is left"


def _lives(process: int) -> bool:
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


async def test_node_opcua_reads_values_units_identity_and_every_measurement() -> None:
    async with running() as there:
        more = ["x_mm.EURange", "yaw_deg.EngineeringUnits", "x_mm.sigma", "SerialNumber", "Model", "causes"]
        answer = await by_node(there.unit.url, keys=KEYS + more)
        assert answer["namespaces"][1:] == [
            f"urn:altd:{SERIAL}",
            "urn:altd:unit",
            "http://opcfoundation.org/UA/DI/",
        ]
        found = answer["read"]
        assert {found[key]["status"] for key in found} == {"Good"}
        assert [found[key]["value"] for key in NUMBERS] == [10.012, 4.987, 1.1459, -1.7184, 10.012]
        assert found["valid"]["value"] is True
        assert 500 <= found["age_ms"]["value"] <= 1500
        captured, served = (datetime.fromisoformat(found["x_mm"][key]) for key in ("source", "server"))
        assert timedelta(seconds=0.5) <= served - captured <= timedelta(seconds=1.5)
        assert (found["x_mm.EURange"]["value"]["low"], found["x_mm.EURange"]["value"]["high"]) == (-70, 70)
        unit = found["yaw_deg.EngineeringUnits"]["value"]
        assert (unit["unitId"], unit["displayName"]["text"]) == (int.from_bytes(b"DD"), "°")
        assert (found["SerialNumber"]["value"], found["Model"]["value"]) == (SERIAL, "Active Laser Target")
        watched = await by_node(there.unit.url, keys=KEYS, seconds=3)
    sequences = [data["value"] for key, data in watched["changes"] if key == "sequence"]
    assert len(sequences) > 20
    assert sequences == sorted(set(sequences))
    assert {data["status"] for _, data in watched["changes"]} == {"Good"}


async def test_node_opcua_reads_the_history_in_the_quality_that_it_had(tmp_path: Path) -> None:
    store = past.store(tmp_path, past.renamed(past.ABOUT, serial=SERIAL))
    samples = [past.sample(past.START_S + second, 10.0 + second, second) for second in range(3000)]
    samples[10] = past.sample(past.START_S + 10, None, 10)
    samples[11] = past.sample(past.START_S + 11, 21.0, 11, Reason.SIMULATED, Reason.REHEARSAL)
    for first in range(0, 3000, 500):
        store.write(past.batch(past.START_S + first + 499, samples[first : first + 500]))
    store.end(None)
    start = datetime.fromisoformat("2026-11-20T08:00:00Z")
    history = History(tmp_path / "history.db")
    async with running(history=history) as there:
        span = {"keys": KEYS, "from": start + timedelta(seconds=5), "to": start + timedelta(hours=2)}
        answer = await by_node(there.unit.url, history="x_mm", **span)
        old = answer["history"]
        assert len(old) == 2995, "with a continuation point"
        assert [each["value"] for each in old[:5]] == [15.0, 16.0, 17.0, 18.0, 19.0]
        assert (old[5]["status"], old[5]["value"]) == ("Bad", None)
        assert (old[6]["status"], old[6]["value"]) == ("UncertainSimulatedValue", 21.0)
        assert old[0]["source"] == "2026-11-20T08:00:05.000Z"
        assert old[-1]["value"] == 3009.0
        assert {each["status"] for each in old[7:]} == {"Good"}
        none = await by_node(there.unit.url, history="valid", **span)
        assert none["history_status"] == "BadHistoryOperationUnsupported"


async def test_node_opcua_needs_the_password_and_the_units_own_certificate(tmp_path: Path) -> None:
    certificate, key = made_certificate(tmp_path, "unit", f"urn:altd:{SERIAL}")
    other, _ = made_certificate(tmp_path, "other", "urn:other")
    users = tmp_path / "users"
    save_credentials(users, Credentials().with_password("plant", PasswordHash.of("a long one")))
    users.chmod(0o600)
    settings = OpcUaSettings(
        host="127.0.0.1", port=0, certificate=certificate, key=key, credentials=users, allow_self_check=True
    )
    async with running(settings=settings) as there:
        there.unit.published.self_check.open(lambda: asked.append(True))
        asked: list[bool] = []
        login = {"keys": KEYS, "secure": True, "user": "plant", "password": "a long one"}
        login |= {"server_certificate": certificate}
        answer = await by_node(there.unit.url, **login, call="SelfCheck")
        assert answer["read"]["x_mm"]["status"] == "Good"
        assert (answer["call"], asked) == ("Good", [True])
        assert "error" in await by_node(there.unit.url, **login | {"user": None})
        assert "error" in await by_node(there.unit.url, keys=KEYS, secure=False)
        assert "error" in await by_node(there.unit.url, **login | {"server_certificate": other})
        assert "error" in await by_node(there.unit.url, **login | {"password": "another"})
        notes = [event.text for event in there.unit.health.events.after(0)]
        assert "a self-check was asked for" in notes


async def test_a_self_check_that_is_not_allowed_or_not_possible_is_refused() -> None:
    settings = OpcUaSettings(host="127.0.0.1", port=0, allow_self_check=True)
    async with running(settings=settings) as there, connected(there.unit.url) as client:
        unit = client.get_node("ns=2;s=unit")
        with pytest.raises(ua.uaerrors.BadInvalidState):
            await unit.call_method("2:SelfCheck")
    async with running() as there, connected(there.unit.url) as client:
        with pytest.raises(ua.UaError):
            await client.get_node("ns=2;s=unit").call_method("2:SelfCheck")


async def test_a_server_that_is_killed_is_started_again_and_health_says_what_it_was() -> None:
    async with running() as there:
        first = there.child
        os.kill(first, signal.SIGKILL)
        await there.until(lambda: there.unit.component.state is State.FAILED)
        assert "status -9" in there.unit.component.message
        await there.serves()
        assert there.child != first
        async with connected(there.unit.url) as client:
            await there.until(lambda: there.unit.component.figures.get("clients") == 1)
            assert (await read(client, "x_mm"))["x_mm"].status is Status.GOOD


async def test_a_defect_while_serving_ends_the_process_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Status 0 and no message would leave the health of the daemon without a cause."""

    async def fail(_: object) -> None:
        raise RuntimeError("planted")

    async def measuring(lines: BinaryIO) -> None:
        for sequence in range(10**9):
            unit.measure(sequence)
            lines.write(unit.line())
            await asyncio.sleep(0.05)

    unit, (receiver, sender) = OpcUaUnit(), os.pipe()
    monkeypatch.setattr(opcua_process, "_keep", fail)
    monkeypatch.setattr(sys, "stdin", os.fdopen(receiver))
    with listen("127.0.0.1", 0) as listener, os.fdopen(sender, "wb", 0) as lines:
        unit.publisher.port = listener.getsockname()[1]
        lines.write(unit.start.to_line())
        measured = asyncio.create_task(measuring(lines))
        with pytest.raises(RuntimeError, match="planted"):
            await opcua_process.serve(os.dup(listener.fileno()))
        measured.cancel()
    gc.unfreeze()


async def test_a_server_that_was_held_up_shows_nothing_that_is_old() -> None:
    """While it is stopped measuring continues; what waited in the pipe is not shown as new."""
    async with running() as there, connected(there.unit.url) as client:
        await read(client, "x_mm")
        os.kill(there.child, signal.SIGSTOP)
        skipped = there.unit.component.counters["measurements_skipped"]
        begun = there.unit.board.published
        await there.until(lambda: there.unit.board.published >= begun + 50)
        await there.until(lambda: there.unit.component.counters["measurements_skipped"] == skipped)
        os.kill(there.child, signal.SIGCONT)
        found = await read(client, *NUMBERS)
        for key in NUMBERS:
            source = found[key].source
            assert found[key].status.is_bad or (source is not None and datetime.now(UTC) - source < SOON)
        await there.until(lambda: there.unit.component.counters["measurements_skipped"] > skipped + 30)


async def test_without_a_client_the_server_gets_few_measurements(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = 0

    def counted(*arguments: Any) -> str:
        nonlocal lines
        lines += 1
        return checked_line(*arguments)

    monkeypatch.setattr(publisher, "checked_line", counted)
    async with running() as there:

        async def of_forty() -> int:
            before, begun = lines, there.unit.board.published
            await there.until(lambda: there.unit.board.published >= begun + 40)
            return lines - before

        assert 1 <= await of_forty() <= 10
        async with connected(there.unit.url) as client:
            await read(client, "x_mm")
            assert await of_forty() >= 20
        await there.until(lambda: there.unit.component.figures.get("clients") == 0)
        assert await of_forty() <= 10
        assert there.unit.component.counters["measurements_skipped"] <= 20


async def test_no_measurement_means_no_number_soon_after() -> None:
    async with running(is_measuring=False, stale_after_s=3.0) as there, connected(there.unit.url) as client:
        assert {each.status for each in (await read(client, *NUMBERS)).values()} == {
            Status.BAD_WAITING_FOR_INITIAL_DATA
        }
        there.unit.measure()
        deadline_s = time.monotonic() + 20
        seen = set()
        while time.monotonic() < deadline_s and Status.BAD_NO_COMMUNICATION not in seen:
            found = await read(client, "x_mm")
            seen.add(found["x_mm"].status)
        assert seen >= {Status.GOOD, Status.BAD_NO_COMMUNICATION}


def test_the_server_ends_with_its_daemon_however_that_ends() -> None:
    script = textwrap.dedent("""
        import asyncio, sys
        sys.path[:0] = ["tests", "."]
        from support.opcua import OpcUaUnit
        async def said(unit):
            while unit.publisher.process is None:
                await asyncio.sleep(0)
            print(unit.publisher.process.pid, flush=True)
        async def main():
            unit = OpcUaUnit()
            await unit.publisher.run(lambda: print(unit.publisher.process.pid, flush=True))
        asyncio.run(main())
    """)
    at_once = "asyncio.create_task(said(unit)); await unit.publisher.run(lambda: None)"
    soon = script.replace(
        "await unit.publisher.run(lambda: print(unit.publisher.process.pid, flush=True))", at_once
    )
    for stop, source in ((None, script), (signal.SIGSTOP, script), (None, soon)):
        daemon = subprocess.Popen([sys.executable, "-c", source], cwd=ROOT, stdout=subprocess.PIPE)
        assert daemon.stdout is not None
        server = int(daemon.stdout.readline())
        if stop is not None:
            os.kill(server, stop)  # it cannot read that its input has ended
        daemon.kill()
        daemon.wait()
        daemon.stdout.close()
        deadline_s = time.monotonic() + 20
        while _lives(server):
            assert time.monotonic() < deadline_s, "it outlived its daemon"
            time.sleep(0.02)


async def test_a_reload_refuses_an_address_in_use() -> None:
    port = free_port()
    async with running(settings=OpcUaSettings(host="127.0.0.1", port=port)):
        second = OpcUaUnit(settings=OpcUaSettings(host="127.0.0.1", port=port))
        with pytest.raises(BadInputError, match="opcua: Address already in use"):
            await keep_running("opcua", second.publisher, second.component, second.clock, refuses=True)


def test_without_its_package_the_daemon_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publisher, "find_spec", lambda name: None)
    with pytest.raises(BadInputError, match=r"^\[opcua\]: needs asyncua.*pip install 'altd\[opcua\]'$"):
        OpcUaUnit()


async def test_clients_that_vanish_with_a_thousand_subscriptions_leave_the_memory_flat() -> None:
    """asyncua keeps the subscriptions of clients that are gone, for as long as these have asked for."""
    wanted = ua.CreateSubscriptionParameters(1e-3, 2**31, 2**31, 0, True)
    async with running() as there:
        figures = there.unit.component

        async def vanish() -> None:
            client = Client(there.unit.url, timeout=20, watchdog_intervall=60)
            await client.connect()
            for _ in range(8):
                made = await client.uaclient.create_subscription(wanted, lambda _: None)
                items = ua.CreateMonitoredItemsParameters(SubscriptionId=made.SubscriptionId)
                for key in KEYS:
                    item = ua.MonitoredItemCreateRequest()
                    node = client.get_node(f"ns=2;s={key}").nodeid
                    item.ItemToMonitor = ua.ReadValueId(node, ua.AttributeIds.Value)
                    item.RequestedParameters.QueueSize = 10**6
                    items.ItemsToCreate.append(item)
                await client.uaclient.create_monitored_items(items)
            client.uaclient.protocol.transport.abort()
            with contextlib.suppress(ConnectionError, ua.UaError):
                await client.disconnect()

        for _ in range(34):  # 272 subscriptions: more than fit
            await vanish()
        await there.until(lambda: figures.figures.get("subscriptions") == 256)
        before_mb = figures.figures["rss_mb"]
        for _ in range(45):
            await vanish()
        await there.until(lambda: figures.figures.get("subscriptions") == 256)
        after_mb = figures.figures["rss_mb"]
        assert isinstance(before_mb, float)
        assert isinstance(after_mb, float)
        assert after_mb < before_mb + 15
        async with connected(there.unit.url) as client:
            assert (await read(client, "x_mm"))["x_mm"].status is Status.GOOD
