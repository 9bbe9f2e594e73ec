"""The standard's own nodes: limits that hold, namespaces that are described, nothing null with Good."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator

import pytest
from asyncua import Client, ua
from asyncua.common.node import Node
from support.opcua import OpcUaUnit, connected

from altd.config import Installation
from altd.instruments.beam.instrument import quantities_of
from altd.instruments.planar.instrument import QUANTITIES as OF_PLATE
from altd.publish.opcua.publisher import ranges_of


@pytest.fixture
async def client() -> AsyncIterator[Client]:
    unit = OpcUaUnit()
    async with unit.served(), connected(unit.url) as client:
        yield client


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
