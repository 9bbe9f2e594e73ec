"""The standard's own nodes and status codes: limits that hold, nothing null with Good, why not."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Awaitable
from datetime import UTC, datetime
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.common.node import Node
from support.opcua import OpcUaUnit, connected

from altd.config import Installation, OpcUaSettings
from altd.instruments.beam.instrument import quantities_of
from altd.instruments.planar.instrument import QUANTITIES as OF_PLATE
from altd.publish.opcua.publisher import ranges_of


@pytest.fixture
async def client() -> AsyncIterator[Client]:
    unit = OpcUaUnit(settings=OpcUaSettings(host="127.0.0.1", port=0, allow_self_check=True))
    async with unit.served() as there, connected(unit.url) as client:
        unit.measure()
        await there.take(unit.line())
        yield client


VALUE, NONE = ua.AttributeIds.Value, ua.NodeId("none", 2)
X_MM, OBJECTS = ua.NodeId("x_mm", 2), ua.NodeId(ua.ObjectIds.ObjectsFolder)
STAMPS = ua.TimestampsToReturn


async def code_of(awaitable: Awaitable[Any]) -> str:
    """The name of the status code of a request, or of its only operation."""
    try:
        (result,) = await awaitable
    except ua.UaStatusCodeError as error:
        return str(ua.StatusCode(error.code).name)
    return str((result if isinstance(result, ua.StatusCode) else result.StatusCode).name)


def item(of: ua.ReadValueId) -> ua.MonitoredItemCreateRequest:
    return ua.MonitoredItemCreateRequest(of, ua.MonitoringMode.Reporting, ua.MonitoringParameters())


async def test_a_read_that_cannot_be_met_says_why(client: Client) -> None:
    """OPC 10000-4, 5.11.2 and 5.13.2. asyncua would give the whole value, and all timestamps."""
    async with connected(client.server_url.geturl()) as own:
        to, name = own.uaclient, ua.AttributeIds.BrowseName
        made = await to.create_subscription(ua.CreateSubscriptionParameters(100.0), lambda _: None)

        async def codes(of: ua.ReadValueId, stamps: ua.TimestampsToReturn = STAMPS.Both) -> set[str]:
            many = ua.CreateMonitoredItemsParameters(made.SubscriptionId, stamps, [item(of)])
            reading = to.read(ua.ReadParameters(0.0, stamps, [of]))
            return {await code_of(reading), await code_of(to.create_monitored_items(many))}

        encoding = ua.QualifiedName("Default Binary")
        assert await codes(ua.ReadValueId(X_MM, VALUE)) == {"Good"}
        assert await codes(ua.ReadValueId(NONE, VALUE)) == {"BadNodeIdUnknown"}
        for attribute in (99, ua.AttributeIds.Executable):
            assert await codes(ua.ReadValueId(X_MM, attribute)) == {"BadAttributeIdInvalid"}
        assert await codes(ua.ReadValueId(X_MM, VALUE, "0:1")) == {"BadIndexRangeNoData"}
        assert await codes(ua.ReadValueId(X_MM, name, DataEncoding=encoding)) == {"BadDataEncodingInvalid"}
        assert await codes(ua.ReadValueId(X_MM, VALUE), STAMPS.Invalid) == {"BadTimestampsToReturnInvalid"}
        of_x = [ua.ReadValueId(X_MM, VALUE)]
        assert await code_of(to.read(ua.ReadParameters(-1.0, STAMPS.Both, of_x))) == "BadMaxAgeInvalid"
        for stamps, has_source, has_server in (
            (STAMPS.Source, True, False),
            (STAMPS.Server, False, True),
            (STAMPS.Both, True, True),
            (STAMPS.Neither, False, False),
        ):
            (data,) = await to.read(ua.ReadParameters(0.0, stamps, of_x))
            assert (data.SourceTimestamp is not None, data.ServerTimestamp is not None) == (
                has_source,
                has_server,
            )


async def test_a_browse_that_cannot_be_met_says_why(client: Client) -> None:
    """OPC 10000-4, 5.9.2 and 5.9.4."""

    async def code(view: ua.NodeId = ua.NodeId(), **asked: Any) -> str:  # noqa: B008
        wanted = ua.BrowseDescription(**{"NodeId": OBJECTS} | asked)
        return await code_of(
            client.uaclient.browse(ua.BrowseParameters(ua.ViewDescription(view), 0, [wanted]))
        )

    assert await code() == await code(ReferenceTypeId=ua.NodeId(ua.ObjectIds.References)) == "Good"
    assert await code(NodeId=NONE) == "BadNodeIdUnknown"
    assert await code(BrowseDirection=ua.BrowseDirection.Invalid) == "BadBrowseDirectionInvalid"
    for kind in (NONE, OBJECTS):
        assert await code(ReferenceTypeId=kind) == "BadReferenceTypeIdInvalid"
    assert await code(view=NONE) == "BadViewIdUnknown"
    path = ua.BrowsePath(NONE, ua.RelativePath([ua.RelativePathElement(TargetName=ua.QualifiedName("x"))]))
    assert await code_of(client.uaclient.translate_browsepaths_to_nodeids([path])) == "BadNodeIdUnknown"


async def test_a_call_that_cannot_be_met_says_why_and_calls_nothing(client: Client) -> None:
    """OPC 10000-4, 5.12.2."""
    (method,) = await client.get_node("ns=2;s=unit").get_methods()
    unit = ua.NodeId("unit", 2)
    for wanted, code in (
        (ua.CallMethodRequest(unit, NONE), "BadMethodInvalid"),
        (ua.CallMethodRequest(unit, ua.NodeId("valid", 2)), "BadMethodInvalid"),
        (ua.CallMethodRequest(OBJECTS, method.nodeid), "BadMethodInvalid"),
        (ua.CallMethodRequest(NONE, method.nodeid), "BadNodeIdUnknown"),
        (ua.CallMethodRequest(unit, method.nodeid, [ua.Variant(1)]), "BadTooManyArguments"),
    ):
        assert await code_of(client.uaclient.call([wanted])) == code


async def test_a_history_read_that_cannot_be_met_says_why(client: Client) -> None:
    """OPC 10000-4, 5.11.3."""
    span = ua.ReadRawModifiedDetails(False, datetime(2026, 11, 1, tzinfo=UTC), datetime.now(UTC), 10)
    for node, stamps, code in (
        (NONE, STAMPS.Source, "BadNodeIdUnknown"),
        (ua.NodeId("valid", 2), STAMPS.Source, "BadHistoryOperationUnsupported"),
        (X_MM, STAMPS.Neither, "BadTimestampsToReturnInvalid"),
        (X_MM, STAMPS.Invalid, "BadTimestampsToReturnInvalid"),
        (X_MM, STAMPS.Both, "BadNoDataAvailable"),
    ):
        wanted = ua.HistoryReadParameters(span, stamps, False, [ua.HistoryReadValueId(node)])
        assert await code_of(client.uaclient.history_read(wanted)) == code


async def test_notifications_are_numbered_and_kept_until_they_are_acknowledged(client: Client) -> None:
    """OPC 10000-4, 5.14.1.1 and 5.14.6: an empty one has the number of the next."""
    heard: asyncio.Queue[Any] = asyncio.Queue()
    async with connected(client.server_url.geturl()) as own:
        to, wanted = own.uaclient, ua.CreateSubscriptionParameters(50.0, 100, 1, PublishingEnabled=True)
        made, numbers = await to.create_subscription(wanted, heard.put_nowait), list[int]()
        for _ in range(2):
            of_x = [item(ua.ReadValueId(X_MM, VALUE))]
            await to.create_monitored_items(
                ua.CreateMonitoredItemsParameters(made.SubscriptionId, STAMPS.Both, of_x)
            )
            while not (
                told := (await asyncio.wait_for(heard.get(), 60)).NotificationMessage
            ).NotificationData:
                assert told.SequenceNumber == len(numbers) + 1
            numbers.append(told.SequenceNumber)
        assert numbers == [1, 2]
        again = ua.RepublishRequest(Parameters=ua.RepublishParameters(made.SubscriptionId, 99))
        with pytest.raises(ua.uaerrors.BadMessageNotAvailable):
            await to.protocol.send_request(again)


async def test_a_session_has_a_timeout_and_a_nonce(client: Client) -> None:
    """OPC 10000-4, 5.7.2."""
    for wanted_ms, revised_ms in ((5e3, 5e3), (3.6e6, 6e4), (0.0, 5e3), (math.nan, 6e4)):
        own = Client(client.server_url.geturl(), timeout=200)
        await own.connect_sessionless()
        asked = ua.CreateSessionParameters(
            RequestedSessionTimeout=wanted_ms, EndpointUrl=own.server_url.geturl()
        )
        made = await own.uaclient.create_session(asked)
        await own.disconnect_sessionless()
        assert made.RevisedSessionTimeout == revised_ms
        assert len(made.ServerNonce) >= 32


async def variables_below(node: Node, seen: set[ua.NodeId]) -> AsyncIterator[Node]:
    kinds, forward = ua.ObjectIds.HierarchicalReferences, ua.BrowseDirection.Forward
    for each in await node.get_references(kinds, forward):
        below = Node(node.session, each.NodeId)
        if each.NodeId not in seen and each.NodeClass in (ua.NodeClass.Object, ua.NodeClass.Variable):
            seen.add(each.NodeId)
            if each.NodeClass is ua.NodeClass.Variable:
                yield below
            async for further in variables_below(below, seen):
                yield further


async def test_nothing_of_the_server_is_null_with_good(client: Client) -> None:
    seen = 0
    async for node in variables_below(client.get_node("i=2253"), set()):
        data = await node.read_data_value(raise_on_bad_status=False)
        seen += 1
        assert data.Value.Value is not None or data.StatusCode.is_bad(), node
    assert seen > 100


async def test_the_limits_that_are_stated_hold(client: Client) -> None:
    limits = client.get_node("i=11704")
    stated = {
        (await each.read_browse_name()).Name: await each.read_value() for each in await limits.get_children()
    }
    assert (stated["MaxNodesPerRead"], stated["MaxNodesPerMethodCall"]) == (500, 1)
    assert stated["MaxNodesPerHistoryReadData"] == 16
    node = client.get_node("ns=2;s=valid")
    for most, ask in (
        (stated["MaxNodesPerRead"], lambda n: client.read_values([node] * n)),
        (stated["MaxNodesPerBrowse"], lambda n: client.browse_nodes([node] * n)),
        (
            stated["MaxNodesPerTranslateBrowsePathsToNodeIds"],
            lambda n: client.translate_browsepaths(node.nodeid, ["0:x"] * n),
        ),
    ):
        await ask(most)
        with pytest.raises(ua.UaStatusCodeError, match="too many operations"):
            await ask(most + 1)
    capabilities = {2269: list, 2271: ["en"], 24095: 32, 24096: 256, 24098: 8, 24104: 256, 11193: False}
    for number, expected in capabilities.items():
        value = await client.get_node(f"i={number}").read_value()
        assert isinstance(value, list) if expected is list else value == expected


async def test_every_namespace_is_described(client: Client) -> None:
    described = {}
    for each in await client.get_node("i=11715").get_children():
        about = {(await below.read_browse_name()).Name: below for below in await each.get_children()}
        described[await about["NamespaceUri"].read_value()] = about
    assert list(described) == await client.get_namespace_array()
    assert await described["urn:altd:unit"]["NamespaceVersion"].read_value() == "0.1.0"
    assert await described["http://opcfoundation.org/UA/DI/"]["IsNamespaceSubset"].read_value() is True


async def test_the_type_of_the_unit_declares_its_members(client: Client) -> None:
    kind, unit = client.get_node("ns=2;s=ActiveLaserTargetType"), client.get_node("ns=2;s=unit")
    has = {(await each.read_browse_name()).to_string() for each in await unit.get_children()}
    rules = {}
    for each in await kind.get_children():
        (rule,) = await each.get_references(ua.ObjectIds.HasModellingRule)
        rules[(await each.read_browse_name()).to_string()] = rule.NodeId.Identifier
    mandatory = {name for name, rule in rules.items() if rule == ua.ObjectIds.ModellingRule_Mandatory}
    assert mandatory <= has
    assert mandatory >= {"2:Valid", "2:Sequence", "2:Reasons", "3:DeviceHealth", "2:Session"}
    optional = {name.removeprefix("2:") for name in rules.keys() - mandatory}
    assert optional == {each.key for each in (*quantities_of(Installation()).of_unit, *OF_PLATE.of_unit)}
    valid = client.get_node("ns=2;s=ActiveLaserTargetType.valid")
    assert await valid.read_data_type() == ua.NodeId(ua.ObjectIds.Boolean)


@pytest.mark.parametrize("plane_mm", [0.0, -5000.0, 280.0])
def test_ranges_and_meanings_are_those_of_the_reference_plane(plane_mm: float) -> None:
    """The beam meets a plane z at x + z · slope; its slopes are at most 110 and 250 mm/m."""
    installation = Installation(reference_plane_mm=plane_mm, offset_x_mm=3.0, sign_y=-1)
    ranges = ranges_of(installation)
    reach_mm = 70.0 + abs(plane_mm) * 0.110
    assert ranges["x_mm"] == pytest.approx((3.0 - reach_mm, 3.0 + reach_mm))
    assert ranges["y_mm"][1] == pytest.approx(55.0 + abs(plane_mm) * 0.250)
    assert ranges["yaw_deg"][1] == pytest.approx(math.degrees(math.atan(0.110)))
    meanings = {each.key: each.meaning for each in quantities_of(installation).of_unit}
    plane = f"in the plane z = {plane_mm:g} mm" if plane_mm else "at the front target"
    right = "to the right as seen along the beam"
    assert meanings["x_mm"] == f"displacement of the beam {plane}, {right}, plus 3 mm"
    assert meanings["y_mm"] == "the same, upwards, sign reversed"
    assert meanings["yaw_deg"] == "direction of the beam, atan of its slope in x"
