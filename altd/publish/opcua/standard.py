"""Values of the standard's own nodes (OPC 10000-5, 6.3): limits, capabilities and namespaces.

asyncua states limits that are not those of this server, and leaves the other nodes null with Good.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from typing import Any

from asyncua import Server, ua

from altd.publish.opcua.history import MAX_VALUES
from altd.publish.opcua.server import MAX_REQUEST_BYTES, MAX_SESSIONS
from altd.publish.opcua.sessions import (
    MAX_HISTORY_NODES,
    MAX_METHODS,
    MAX_MONITORED_ITEMS,
    MAX_OPERATIONS,
    MAX_QUEUED_VALUES,
    MAX_SUBSCRIPTIONS,
    MIN_PUBLISHING_INTERVAL_MS,
)
from altd.publish.opcua.start import Start
from altd.publish.opcua.types import DI_NAMESPACE, UNIT_NAMESPACE

_CAPABILITIES = "Server_ServerCapabilities_"
_HISTORY = "HistoryServerCapabilities_"
_TRANSPORT = "http://opcfoundation.org/UA-Profile/Transport/uatcp-uasc-uabinary"

_OF_DI = "1.04.0", datetime(2022, 11, 3, tzinfo=UTC)
"""Version of OPC 10000-100 whose nodes the unit refers to, and its date."""


def values_of(start: Start) -> Iterator[tuple[str, ua.Variant]]:
    """Yield the names of nodes, as in ``ua.ObjectIds``, with their values."""
    kinds = ua.VariantType
    for name in (
        *("Read", "Write", "Browse", "RegisterNodes", "TranslateBrowsePathsToNodeIds", "NodeManagement"),
        *("HistoryUpdateData", "HistoryUpdateEvents"),
    ):
        yield f"{_CAPABILITIES}OperationLimits_MaxNodesPer{name}", ua.Variant(MAX_OPERATIONS, kinds.UInt32)
    for name, number, kind in (
        ("OperationLimits_MaxMonitoredItemsPerCall", MAX_OPERATIONS, kinds.UInt32),
        ("OperationLimits_MaxNodesPerMethodCall", MAX_METHODS, kinds.UInt32),
        ("OperationLimits_MaxNodesPerHistoryReadData", MAX_HISTORY_NODES, kinds.UInt32),
        ("OperationLimits_MaxNodesPerHistoryReadEvents", MAX_HISTORY_NODES, kinds.UInt32),
        ("MinSupportedSampleRate", MIN_PUBLISHING_INTERVAL_MS, kinds.Double),
        ("MaxBrowseContinuationPoints", 0, kinds.UInt16),
        ("MaxQueryContinuationPoints", 0, kinds.UInt16),
        ("MaxHistoryContinuationPoints", 0, kinds.UInt16),
        ("MaxArrayLength", MAX_REQUEST_BYTES, kinds.UInt32),
        ("MaxStringLength", MAX_REQUEST_BYTES, kinds.UInt32),
        ("MaxByteStringLength", MAX_REQUEST_BYTES, kinds.UInt32),
        ("MaxSessions", MAX_SESSIONS, kinds.UInt32),
        ("MaxSubscriptions", MAX_SESSIONS * MAX_SUBSCRIPTIONS, kinds.UInt32),
        ("MaxMonitoredItems", MAX_SESSIONS * MAX_MONITORED_ITEMS, kinds.UInt32),
        ("MaxSubscriptionsPerSession", MAX_SUBSCRIPTIONS, kinds.UInt32),
        ("MaxMonitoredItemsPerSubscription", MAX_MONITORED_ITEMS, kinds.UInt32),
        ("MaxMonitoredItemsQueueSize", MAX_QUEUED_VALUES, kinds.UInt32),
    ):
        yield _CAPABILITIES + name, ua.Variant(number, kind)
    yield f"{_CAPABILITIES}ServerProfileArray", ua.Variant([_TRANSPORT], kinds.String)
    yield f"{_CAPABILITIES}LocaleIdArray", ua.Variant(["en"], kinds.String)
    yield f"{_HISTORY}AccessHistoryDataCapability", ua.Variant(start.history is not None)
    yield f"{_HISTORY}MaxReturnDataValues", ua.Variant(MAX_VALUES, kinds.UInt32)
    yield f"{_HISTORY}MaxReturnEventValues", ua.Variant(0, kinds.UInt32)
    for name in (
        *("AccessHistoryEvents", "InsertData", "ReplaceData", "UpdateData", "DeleteRaw", "DeleteAtTime"),
        *("InsertEvent", "ReplaceEvent", "UpdateEvent", "DeleteEvent", "InsertAnnotation"),
    ):
        yield f"{_HISTORY}{name}Capability", ua.Variant(False)
    yield f"{_HISTORY}ServerTimestampSupported", ua.Variant(False)
    yield "Server_Auditing", ua.Variant(False)
    yield "Server_ServerStatus_SecondsTillShutdown", ua.Variant(0, kinds.UInt32)
    yield "Server_ServerStatus_ShutdownReason", ua.Variant(ua.LocalizedText(""))


async def fill_standard_nodes(server: Server, start: Start) -> None:
    """Write the values, describe the namespaces, and mark what is not supported as such."""
    for name, value in values_of(start):
        await server.get_node(ua.NodeId(getattr(ua.ObjectIds, name))).write_value(value)
    now = datetime.now(UTC)
    own = await server.get_namespace_array()
    numeric, text = [ua.IdType.Numeric], [ua.IdType.String]
    await _describe(server, own[1], start.version, now, text, is_subset=False)
    await _describe(server, UNIT_NAMESPACE, start.version, now, text, is_subset=False)
    await _describe(server, DI_NAMESPACE, *_OF_DI, numeric, is_subset=True)
    await _mark_unsupported(server, ua.NodeId(ua.ObjectIds.Server))


async def _describe(
    server: Server, uri: str, version: str, date: datetime, kinds: list[ua.IdType], *, is_subset: bool
) -> None:
    """Add a ``NamespaceMetadataType`` object (OPC 10000-5, 6.3.13)."""
    index = await server.get_namespace_index(uri)
    namespaces = server.get_node(ua.NodeId(ua.ObjectIds.Server_Namespaces))
    node, kind = ua.NodeId(f"Namespaces.{uri}", 1), ua.NodeId(ua.ObjectIds.NamespaceMetadataType)
    about = await namespaces.add_object(node, ua.QualifiedName(uri, index), kind, instantiate_optional=False)
    for name, value in {
        "NamespaceUri": ua.Variant(uri),
        "NamespaceVersion": ua.Variant(version),
        "NamespacePublicationDate": ua.Variant(date),
        "IsNamespaceSubset": ua.Variant(is_subset),
        "StaticNodeIdTypes": ua.Variant(kinds, ua.VariantType.Int32),
        "StaticNumericNodeIdRange": ua.Variant([], ua.VariantType.String, is_array=True),
        "StaticStringNodeIdPattern": ua.Variant(""),
    }.items():
        await (await about.get_child(f"0:{name}")).write_value(value)


async def _mark_unsupported(server: Server, root: ua.NodeId) -> None:
    """Make every variable of the standard below ``root`` that has no value ``BadNotSupported``."""
    space, missing = server.iserver.aspace, ua.StatusCode(ua.StatusCodes.BadNotSupported)
    seen, found = {root}, [root]
    while found:
        node = space[found.pop()]
        fresh = {each for each in _below(node.references) if each not in seen}
        seen |= fresh
        found += fresh
        value = node.attributes.get(ua.AttributeIds.Value)
        if value is not None and value.value is not None and value.value.Value.Value is None:
            value.value = ua.DataValue(ua.Variant(None), StatusCode=missing)


def _below(references: Iterable[Any]) -> Iterator[ua.NodeId]:
    instances = {ua.NodeClass.Object, ua.NodeClass.Variable}
    return (each.NodeId for each in references if each.IsForward and each.NodeClass in instances)
