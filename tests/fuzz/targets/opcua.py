"""Requests into the OPC UA server: another client reads what is true all the same, and nothing changes."""

import asyncio
import contextlib
import logging
from collections.abc import Callable
from typing import Any

from asyncua import Client, ua
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.common.utils import Buffer
from asyncua.crypto.security_policies import SecurityPolicyNone
from asyncua.ua.ua_binary import header_from_binary, struct_from_binary, struct_to_binary
from asyncua.ua.ua_binary import uatcp_to_binary as packed
from fuzz.served import Faces, read_all, served
from fuzz.spoil import spoilt_bytes
from hypothesis import strategies as st
from support.opcua import OpcUaUnit, connected, read

from altd.config import OpcUaSettings
from altd.publish.opcua.process import ServedUnit
from altd.publish.opcua.quality import Status
from altd.publish.opcua.server import MAX_SESSIONS

NAME = "opcua"
_X = ua.NodeId("x_mm", 2)
_UNIT = ua.NodeId("unit", 2)


def _requests() -> list[Any]:
    """One of each service, with its fields filled."""
    reading, writing = ua.ReadRequest(), ua.WriteRequest()
    browsing, calling = ua.BrowseRequest(), ua.CallRequest()
    reading.Parameters.NodesToRead = [ua.ReadValueId(_X, ua.AttributeIds.Value)] * 3
    forged = ua.DataValue(ua.Variant(99.0))
    writing.Parameters.NodesToWrite = [ua.WriteValue(_X, ua.AttributeIds.Value, Value=forged)]
    browsing.Parameters.NodesToBrowse = [ua.BrowseDescription(_UNIT, ResultMask=63)]
    method = ua.NodeId("SelfCheck", 2)
    calling.Parameters.MethodsToCall = [ua.CallMethodRequest(_UNIT, method, [ua.Variant(1)])]
    history = ua.HistoryReadRequest()
    history.Parameters.HistoryReadDetails = ua.ReadRawModifiedDetails()
    history.Parameters.NodesToRead = [ua.HistoryReadValueId(_X)]
    subscribing, monitoring = ua.CreateSubscriptionRequest(), ua.CreateMonitoredItemsRequest()
    subscribing.Parameters = ua.CreateSubscriptionParameters(100.0, 100, 10, 0, True)
    items = [ua.MonitoredItemCreateRequest()]
    monitoring.Parameters = ua.CreateMonitoredItemsParameters(78, ItemsToCreate=items)
    adding, registering = ua.AddNodesRequest(), ua.RegisterServerRequest()
    adding.Parameters.NodesToAdd = [ua.AddNodesItem(ParentNodeId=_UNIT)]
    deleting = ua.DeleteSubscriptionsRequest()
    deleting.Parameters.SubscriptionIds = [78, 79]
    path = ua.RelativePath([ua.RelativePathElement(TargetName=ua.QualifiedName("x_mm", 2))])
    finding = ua.TranslateBrowsePathsToNodeIdsRequest()
    finding.Parameters.BrowsePaths = [ua.BrowsePath(_UNIT, path)]
    others = (
        ua.PublishRequest(),
        ua.GetEndpointsRequest(),
        ua.FindServersRequest(),
        ua.CreateSessionRequest(),
    )
    more = (reading, writing, browsing, calling, history, subscribing, monitoring, adding, registering)
    return [*more, deleting, finding, *others, ua.CloseSessionRequest(), ua.RegisterNodesRequest()]


_BODIES = tuple(struct_to_binary(request) for request in _requests())
_STREAMS = st.lists(st.sampled_from(_BODIES) | spoilt_bytes(st.sampled_from(_BODIES)), min_size=1, max_size=5)
_KINDS = b"HELF", b"OPNF", b"MSGF", b"CLOF"
EXAMPLES = st.tuples(_STREAMS, st.booleans(), spoilt_bytes(st.sampled_from(_KINDS)))
"""Bodies of requests, whether in a session, and bytes behind them."""


class _Channel:
    """A client without security, by hand."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer
        self._secure = SecureConnection(SecurityPolicyNone(), TransportLimits())
        self._number = 0

    def send(self, body: bytes, kind: Any = ua.MessageType.SecureMessage) -> None:
        self._number += 1
        self._writer.write(self._secure.message_to_binary(body, kind, self._number))

    async def ask(self, request: Any, answer: Any, kind: Any = ua.MessageType.SecureMessage) -> Any:
        self.send(struct_to_binary(request), kind)
        head = header_from_binary(Buffer(await self._reader.readexactly(12)))
        body = await self._reader.readexactly(head.packet_size - 12)
        message = self._secure.receive_from_header_and_body(head, Buffer(body))
        return struct_from_binary(answer, message.body())

    async def open(self, url: str) -> None:
        self._writer.write(packed(ua.MessageType.Hello, ua.Hello(0, 65535, 65535, 0, 0, url)))
        await self._reader.readexactly(28)
        request = ua.OpenSecureChannelRequest()
        request.Parameters.SecurityMode = ua.MessageSecurityMode.None_
        request.Parameters.RequestedLifetime = 60_000
        opened = await self.ask(request, ua.OpenSecureChannelResponse, ua.MessageType.SecureOpen)
        self._secure.set_channel(opened.Parameters, ua.SecurityTokenRequestType.Issue, b"")

    async def begin_session(self, url: str) -> None:
        request = ua.CreateSessionRequest(Parameters=ua.CreateSessionParameters(EndpointUrl=url))
        await self.ask(request, ua.CreateSessionResponse)
        await self.ask(ua.ActivateSessionRequest(), ua.ActivateSessionResponse)


class _Serving:
    """The server, and a client that stays connected."""

    def __init__(self, faces: Faces) -> None:
        for name in ("asyncua", "asyncio"):  # as the process of the server itself, which logs nothing
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        settings = OpcUaSettings(host="127.0.0.1", port=0)
        self.unit = OpcUaUnit(faces.clock, settings=settings)
        self.there: ServedUnit
        self.client: Client

    async def run(self, ready: Callable[[], None]) -> None:
        async with self.unit.served() as self.there, connected(self.unit.url) as self.client:
            ready()
            await asyncio.Event().wait()


begin = _face = served(_Serving)


def check(example: tuple[list[bytes], bool, bytes]) -> None:
    """The next client is answered as before, by a server that holds no more than before."""
    faces, serving = _face()
    shared = serving.there.server.limited
    before = len(shared.aspace.keys())
    found = faces.do(_exchange(serving, *example))
    assert found["x_mm"].value == 10.012
    assert found["x_mm"].status is Status.GOOD
    assert found["valid"].value is True
    assert len(shared.aspace.keys()) == before, "a node was made"
    assert len(shared._known_servers) == 1, "a server was registered"  # noqa: SLF001
    assert len(shared.sessions) <= MAX_SESSIONS, "sessions are left"


async def _exchange(serving: _Serving, bodies: list[bytes], in_session: bool, behind: bytes) -> Any:
    unit = serving.unit
    unit.measure()
    await serving.there.take(unit.line())
    reader, writer = await asyncio.open_connection("127.0.0.1", unit.publisher.port)
    with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
        async with asyncio.timeout(10):
            channel = _Channel(reader, writer)
            await channel.open(unit.url)
            if in_session:
                await channel.begin_session(unit.url)
            for body in bodies:
                channel.send(body)
            channel.send(struct_to_binary(ua.CloseSecureChannelRequest()), ua.MessageType.SecureClose)
            writer.write(behind)
            await read_all(reader)
    writer.transport.abort()
    return await read(serving.client, "x_mm", "valid")
