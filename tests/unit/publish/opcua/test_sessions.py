"""Limits of clients, by asyncua's client at the server: asyncua alone has none of them."""

import asyncio
import contextlib
import logging
import math
import socket
import struct
from collections.abc import AsyncIterator
from functools import partial
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.server.internal_session import InternalSession
from asyncua.ua.uaerrors import UaStatusCodeError
from support.clock import FakeClock
from support.opcua import OpcUaUnit, connected, made_certificate, read
from support.ports import free_port

from altd.config import OpcUaSettings
from altd.credentials.file import Credentials, save_credentials
from altd.credentials.hashes import PasswordHash
from altd.publish.opcua import server, sessions
from altd.publish.opcua.process import ServedUnit
from altd.publish.opcua.quality import Status

SECURE = "Basic256Sha256,SignAndEncrypt"
NUMBERS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg", "targets.front.x_mm", "targets.rear.y_mm")


Served = tuple[OpcUaUnit, ServedUnit]


@pytest.fixture(autouse=True)
def quiet() -> Any:
    logging.disable()
    yield
    logging.disable(logging.NOTSET)


@pytest.fixture
async def served() -> AsyncIterator[Served]:
    unit = OpcUaUnit(FakeClock(10**12))
    async with unit.served() as server:
        unit.measure()
        await server.take(unit.line())
        yield unit, server


@pytest.fixture(scope="session")
def secured(tmp_path_factory: pytest.TempPathFactory) -> OpcUaSettings:
    folder = tmp_path_factory.mktemp("opcua")
    certificate, key = made_certificate(folder, "unit", "urn:altd:ALT-0007")
    for name in ("client", "other"):
        made_certificate(folder, name, f"urn:{name}")[1].rename(folder / f"{name}-key.pem")
    users = folder / "users"
    save_credentials(users, Credentials().with_password("plant", PasswordHash.of("a long one")))
    users.chmod(0o600)
    return OpcUaSettings(host="127.0.0.1", port=0, certificate=certificate, key=key, credentials=users)


def security(settings: OpcUaSettings, own: str = "client", servers: str = "unit") -> str:
    assert settings.certificate is not None
    folder = settings.certificate.parent
    return f"{SECURE},{folder / own}.pem,{folder / own}-key.pem,{folder / servers}.pem"


async def code_of(awaitable: Any) -> str:
    """The name of the status code with which a request is refused."""
    try:
        await awaitable
    except UaStatusCodeError as error:
        return str(ua.StatusCode(error.code).name)
    return "Good"


async def subscribe(client: Client, interval_ms: float = 100.0, **items: Any) -> tuple[int, list[Any]]:
    """A subscription by a bare request, and what its items were answered."""
    made = await client.uaclient.create_subscription(_wanted(interval_ms), lambda _: None)
    monitored = ua.CreateMonitoredItemsParameters(SubscriptionId=made.SubscriptionId)
    for key, wanted in items.items():
        item = ua.MonitoredItemCreateRequest()
        item.ItemToMonitor = ua.ReadValueId(client.get_node(f"ns=2;s={key}").nodeid, ua.AttributeIds.Value)
        item.MonitoringMode = ua.MonitoringMode.Reporting
        item.RequestedParameters = ua.MonitoringParameters(Filter=wanted, QueueSize=10**6)
        monitored.ItemsToCreate.append(item)
    results = await client.uaclient.create_monitored_items(monitored) if items else []
    return made.SubscriptionId, results


def _wanted(interval_ms: float) -> ua.CreateSubscriptionParameters:
    wanted = ua.CreateSubscriptionParameters()
    wanted.RequestedPublishingInterval = interval_ms
    wanted.RequestedLifetimeCount = 2**31
    wanted.RequestedMaxKeepAliveCount = 2**31
    wanted.PublishingEnabled = True
    return wanted


async def test_one_read_has_numbers_of_one_measurement(served: Served) -> None:
    unit, there = served

    async def measuring() -> None:
        for sequence in range(10**6):
            unit.measure(sequence)
            await there.take(unit.line())
            await asyncio.sleep(0)

    task = asyncio.create_task(measuring())
    async with connected(unit.url) as client:
        for _ in range(50):
            found = await read(client, *NUMBERS, "sequence", "valid")
            assert len({each.source for each in found.values()}) == 1
            assert {each.status for each in found.values()} == {Status.GOOD}
    task.cancel()


async def test_a_value_that_becomes_bad_and_good_again_is_written_each_time(served: Served) -> None:
    unit, there = served
    async with connected(unit.url) as client:
        for sequence in range(3):
            unit.measure(2 * sequence)
            await there.take(unit.line())
            assert (await read(client, "x_mm"))["x_mm"].value == 10.012
            unit.measure(2 * sequence + 1, values={}, targets=dict.fromkeys(("front", "rear")), motions={})
            await there.take(unit.line())
            found = await read(client, *NUMBERS, "valid")
            assert {found[key].value for key in NUMBERS} == {None}
            assert found["valid"].value is False


async def test_nothing_can_be_written_added_or_registered(served: Served) -> None:
    unit, _ = served
    async with connected(unit.url) as client:
        nodes = ("ns=2;s=x_mm", "ns=2;s=valid", "ns=2;s=health", "i=2294")
        for node in map(client.get_node, nodes):
            data = ua.DataValue(ua.Variant(1.0))
            assert await code_of(node.write_value(data)) == "BadNotWritable"
        objects = client.get_node("i=85")
        assert await code_of(objects.add_object(2, "own")) == "BadUserAccessDenied"
        wanted = ua.RegisteredServer(ServerUri="urn:x", ServerNames=[ua.LocalizedText("x")])
        assert await code_of(client.uaclient.register_server(wanted)) == "BadServiceUnsupported"


async def test_a_session_cannot_be_taken_over_by_its_number(secured: OpcUaSettings) -> None:
    """asyncua counts tokens up, and an activation that fails leaves the session to its client."""
    unit = OpcUaUnit(settings=secured)
    async with unit.served() as there:
        login = {"user": "plant", "password": "a long one", "security": security(secured)}
        async with connected(unit.url, **login) as owner:
            assert (await read(owner, "x_mm"))["x_mm"].status.is_bad
            (token,) = there.server.limited.sessions
            assert isinstance(token.Identifier, bytes)
            assert len(token.Identifier) == 32
            thief = Client(unit.url, timeout=20)
            await thief.set_security_string(security(secured))
            await thief.connect_sessionless()
            last = InternalSession._auth_counter  # noqa: SLF001
            for guess in range(last - 10, last + 1):
                thief.uaclient.protocol.authentication_token = ua.NodeId(guess)
                await code_of(thief.activate_session(username=None))
                assert await code_of(thief.get_node("ns=2;s=x_mm").read_value()) != "Good"
            await thief.disconnect_sessionless()


async def test_who_has_no_password_reads_nothing(secured: OpcUaSettings) -> None:
    unit = OpcUaUnit(settings=secured)
    async with unit.served() as there:

        async def code(**session: Any) -> str:
            there.server.limited.failed_logins.clear()
            try:
                async with connected(unit.url, **session) as client:
                    await client.get_node("ns=2;s=x_mm").read_data_value(raise_on_bad_status=False)
            except UaStatusCodeError as error:
                return str(ua.StatusCode(error.code).name)
            return "Good"

        with_tls = security(secured)
        right = {"user": "plant", "password": "a long one"}
        assert await code(**right, security=with_tls) == "Good"
        assert await code(security=with_tls) == "BadIdentityTokenRejected"
        assert await code(user="plant", password="another", security=with_tls) == "BadUserAccessDenied"
        assert await code(user="nobody", password="a long one", security=with_tls) == "BadUserAccessDenied"
        assert await code(user="admin", password="", security=with_tls) == "BadUserAccessDenied"
        await code(user="plant", password="another", security=with_tls)
        failed = there.server.limited.failed_logins
        assert failed
        failed.update({address: at_s + 3600 for address, at_s in failed.items()})  # on a busy machine, too
        with pytest.raises(UaStatusCodeError):
            async with connected(unit.url, **right, security=with_tls):
                pass  # too soon after the wrong one


async def test_a_channel_without_encryption_is_for_finding_endpoints_alone(secured: OpcUaSettings) -> None:
    """asyncua opens one where none is offered, and then asks for no permission."""
    unit = OpcUaUnit(settings=secured)
    async with unit.served():
        client = Client(unit.url, timeout=20)
        await client.connect_sessionless()
        assert await client.get_endpoints()
        await client.uaclient.create_session(ua.CreateSessionParameters(EndpointUrl=unit.url))
        plain = ua.UserNameIdentityToken("username", "plant", b"a long one")
        await client.uaclient.activate_session(ua.ActivateSessionParameters(UserIdentityToken=plain))
        node = client.get_node("ns=2;s=x_mm")
        assert await code_of(node.read_value()) == "BadUserAccessDenied"
        assert await code_of(client.get_root_node().get_children()) == "BadUserAccessDenied"
        await client.disconnect_sessionless()


async def test_a_client_that_takes_another_for_the_unit_gets_no_channel(secured: OpcUaSettings) -> None:
    unit = OpcUaUnit(settings=secured)
    async with unit.served():
        client = Client(unit.url, timeout=2)
        await client.set_security_string(security(secured, servers="other"))
        with pytest.raises((asyncio.TimeoutError, ConnectionError, ua.UaError)):
            await client.connect()


async def test_subscriptions_of_others_cannot_be_touched(served: Served) -> None:
    unit, _ = served
    async with connected(unit.url) as owner, connected(unit.url) as other:
        number, _ = await subscribe(owner, x_mm=None)
        to = other.uaclient
        wanted = ua.CreateMonitoredItemsParameters(SubscriptionId=number)
        for refused in (
            to.delete_subscriptions([number]),
            to.create_monitored_items(wanted),
            to.delete_monitored_items(ua.DeleteMonitoredItemsParameters(number, [112])),
            to.set_publishing_mode(ua.SetPublishingModeParameters(False, [number])),
            to.set_monitoring_mode(ua.SetMonitoringModeParameters(number, ua.MonitoringMode.Disabled, [112])),
            to.modify_subscription(ua.ModifySubscriptionParameters(SubscriptionId=number)),
        ):
            assert await code_of(refused) == "BadSubscriptionIdInvalid"
        moved = to.transfer_subscriptions(ua.TransferSubscriptionsParameters([number], True))
        assert await code_of(moved) == "BadServiceUnsupported"


async def test_a_deadband_is_refused_because_what_creeps_or_turns_bad_would_stay_unsaid(
    served: Served,
) -> None:
    unit, _ = served
    without = ua.DataChangeFilter(ua.DataChangeTrigger.StatusValueTimestamp)
    with_one = ua.DataChangeFilter(
        ua.DataChangeTrigger.StatusValue, DeadbandType=ua.DeadbandType.Absolute, DeadbandValue=0.1
    )
    async with connected(unit.url) as client:
        number, results = await subscribe(client, x_mm=with_one, y_mm=without, yaw_deg=ua.EventFilter())
        refused = "BadMonitoredItemFilterUnsupported"
        assert [result.StatusCode.name for result in results] == [refused, "Good", refused]
        item = ua.MonitoredItemModifyRequest(
            results[1].MonitoredItemId, ua.MonitoringParameters(Filter=with_one)
        )
        changed = client.uaclient.modify_monitored_items(
            ua.ModifyMonitoredItemsParameters(number, ItemsToModify=[item])
        )
        assert await code_of(changed) == refused


async def test_a_subscription_has_bounds_whatever_it_asks_for(served: Served) -> None:
    unit, there = served
    async with connected(unit.url) as client:
        for interval_ms in (0.0, -1.0, 1e-9, math.nan, math.inf, 1e300):
            made = await client.uaclient.create_subscription(_wanted(interval_ms), lambda _: None)
            assert 50.0 <= made.RevisedPublishingInterval <= 10_000.0
            lifetime_s = made.RevisedPublishingInterval * made.RevisedLifetimeCount / 1000
            assert lifetime_s <= sessions.SESSION_TIMEOUT_S
        number, results = await subscribe(client, x_mm=None)
        assert results[0].RevisedQueueSize == sessions.MAX_QUEUED_VALUES
        item = ua.MonitoredItemModifyRequest(results[0].MonitoredItemId, ua.MonitoringParameters(QueueSize=0))
        await client.uaclient.modify_monitored_items(
            ua.ModifyMonitoredItemsParameters(number, ItemsToModify=[item])
        )
        subscription = there.server.iserver.subscription_service.subscriptions[number]
        (held,) = subscription.monitored_item_srv._monitored_items.values()  # noqa: SLF001
        assert held.queue_size == sessions.MAX_QUEUED_VALUES
        await subscribe(client)
        assert await code_of(subscribe(client)) == "BadTooManySubscriptions"


async def test_a_session_leaves_nothing_behind_even_when_it_asks_to(served: Served) -> None:
    unit, there = served
    subscriptions = there.server.iserver.subscription_service.subscriptions
    client = Client(unit.url, timeout=20)
    await client.connect()
    await subscribe(client, x_mm=None)
    assert len(subscriptions) == 1
    await client.uaclient.close_session(delete_subscriptions=False)
    assert not subscriptions
    await client.disconnect()


async def test_monitored_items_operations_and_connections_have_limits(served: Served) -> None:
    unit, there = served
    async with connected(unit.url) as client:
        number, _ = await subscribe(client)
        codes = []
        for _ in range(2):
            many = ua.CreateMonitoredItemsParameters(SubscriptionId=number)
            for _ in range(200):
                item = ua.MonitoredItemCreateRequest()
                item.ItemToMonitor = ua.ReadValueId(
                    client.get_node("ns=2;s=x_mm").nodeid, ua.AttributeIds.Value
                )
                many.ItemsToCreate.append(item)
            codes += [each.StatusCode.name for each in await client.uaclient.create_monitored_items(many)]
        assert codes.count("Good") == sessions.MAX_MONITORED_ITEMS
        assert codes.count("BadTooManyMonitoredItems") == 400 - sessions.MAX_MONITORED_ITEMS
        nodes = [client.get_node("ns=2;s=x_mm")] * (sessions.MAX_OPERATIONS + 1)
        reading = client.read_attributes(nodes, ua.AttributeIds.Value)
        assert await code_of(reading) == "BadTooManyOperations"
        assert there.figures()["refused"] == 400 - sessions.MAX_MONITORED_ITEMS + 1
    wires = [await asyncio.open_connection("127.0.0.1", unit.publisher.port) for _ in range(20)]
    refused = [await asyncio.wait_for(reader.read(), 60) for reader, _ in wires[8:]]
    assert refused == [b""] * 12
    assert there.figures()["clients"] == server.MAX_CONNECTIONS_OF_ONE_ADDRESS
    for _, writer in wires:
        writer.transport.abort()


async def _flood(writer: asyncio.StreamWriter) -> None:
    for _ in range(4096):
        writer.write(bytes(1 << 14))
        await writer.drain()


@pytest.mark.parametrize(
    "head",
    [struct.pack("<4sI", b"MSGF", 2**31), struct.pack("<4sI", b"OPNF", 2**32 - 1), b"HELF" + b"\xff" * 4],
)
async def test_a_header_that_announces_gigabytes_ends_the_connection_early(
    served: Served, head: bytes
) -> None:
    unit, _ = served
    reader, writer = await asyncio.open_connection("127.0.0.1", unit.publisher.port)
    writer.write(head)
    with pytest.raises(ConnectionError):
        await _flood(writer)
    del reader
    writer.transport.abort()


async def test_sessions_that_are_begun_and_left_are_bounded(served: Served) -> None:
    unit, there = served
    client = Client(unit.url, timeout=20)
    await client.connect_sessionless()
    codes = [await code_of(client.create_session()) for _ in range(5)]
    assert codes == ["Good"] + ["BadTooManySessions"] * 4
    assert len(there.server.limited.sessions) == 1
    await client.disconnect_sessionless()


async def test_a_client_that_comes_back_from_the_same_port_is_served(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A controller may have a fixed port; its old session with a subscription still waits for it."""
    unit, there = served
    loop = asyncio.get_running_loop()
    own = ("127.0.0.1", free_port())
    monkeypatch.setattr(loop, "create_connection", partial(loop.create_connection, local_addr=own))
    for _ in range(2):
        client = Client(unit.url, timeout=20)
        await client.connect()
        assert (await read(client, "x_mm"))["x_mm"].status is Status.GOOD
        await client.uaclient.create_subscription(ua.CreateSubscriptionParameters(), lambda _: None)
        transport = client.uaclient.protocol.transport
        reset = struct.pack("ii", 1, 0)
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset)
        transport.abort()
        with contextlib.suppress(ConnectionError, ua.UaError):
            await client.disconnect()
    for session in list(there.server.limited.sessions.values()):
        await session.close_session()
