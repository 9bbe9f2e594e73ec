"""Client sessions with limits for logins, for what a session holds, and for what it may access.

asyncua 2.1 has the gaps that the class describes. Its private parts that are used: ``server.py``.
"""

from __future__ import annotations

import dataclasses
import math
import secrets
import time
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from typing import Any, TypeVar

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import AddressSpace
from asyncua.server.internal_session import InternalSession

from altd.tcp_port import address_of

SESSION_TIMEOUT_S = 60.0
"""Time without a request until a session and its subscriptions are closed; clients may request less."""

MAX_OPERATIONS = 500
"""Maximum number of operations of one request: nodes to read, browse, monitor, and so on."""
MAX_HISTORY_NODES = 16
MAX_METHODS = 1

MAX_SUBSCRIPTIONS = 8
MAX_MONITORED_ITEMS = 256
"""Maximum numbers of subscriptions and of monitored items of one session."""
MIN_PUBLISHING_INTERVAL_MS = 50.0
MAX_PUBLISHING_INTERVAL_MS = 10_000.0
MAX_QUEUED_VALUES = 20
"""Maximum number of queued values of one monitored item: one second of measurements."""

LOGIN_INTERVAL_S = 2.0
"""Time after a wrong password until the address may try again: each try takes 0.2 s of the process."""

caller: ContextVar[str] = ContextVar("caller")
"""Caller of a method: address, and user name if there is one."""


class Session(InternalSession):
    """A client's session.

    asyncua numbers the tokens of sessions, and a failed activation leaves the session to the connection that
    tried. Any session can delete, move and fill subscriptions of others; subscriptions never due remain. A
    deadband is compared with the previous value instead of the last sent one, so that slow motion is never
    sent. It cannot be compared with a value that has become Bad, which is therefore lost.
    """

    iserver: Any
    """``LimitedServer``."""

    is_left = False
    """Whether its connection has ended; a client may continue it on another connection."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        self._items: dict[tuple[int, int], int] = {}
        self.active_s = time.monotonic()
        """Monotonic time of the last request."""
        super().__init__(*arguments, **named)
        self.iserver.unregister_external_session(self)
        self.auth_token = ua.NodeId(secrets.token_bytes(32), 0)
        self.iserver.register_external_session(self)

    @property
    def items(self) -> Mapping[tuple[int, int], int]:
        """Attributes of the monitored items, by the numbers of subscription and item."""
        own = self._own()
        self._items = {numbers: each for numbers, each in self._items.items() if numbers[0] in own}
        return self._items

    def touch(self) -> None:
        """Note a request."""
        self.active_s = time.monotonic()
        super().touch()

    async def create_session(
        self, params: ua.CreateSessionParameters, *more: Any, **named: Any
    ) -> ua.CreateSessionResult:
        """Begin; with a timeout that is no number the session would never end."""
        if math.isnan(params.RequestedSessionTimeout):
            params.RequestedSessionTimeout = 1000 * SESSION_TIMEOUT_S
        return await super().create_session(params, *more, **named)

    def activate_session(
        self, params: ua.ActivateSessionParameters, peer_certificate: bytes | None
    ) -> ua.ActivateSessionResult:
        """Log in; after a wrong password the address must wait."""
        logins, now_s = self.iserver.failed_logins, time.monotonic()
        for address in [each for each, at_s in logins.items() if now_s - at_s > LOGIN_INTERVAL_S]:
            del logins[address]
        address = str(address_of(self.name[0]))
        has_password = isinstance(params.UserIdentityToken, ua.UserNameIdentityToken)
        if has_password and address in logins:
            self.iserver.refuse("logins")
            raise ServiceError(ua.StatusCodes.BadUserAccessDenied)
        try:
            result = super().activate_session(params, peer_certificate)
        except (ServiceError, ua.UaStatusCodeError):
            if has_password:
                logins[address] = now_s
            self.iserver.refuse("logins")
            raise
        self.is_left = False
        return result

    async def close_session(self, delete_subs: bool = True) -> None:
        """End the session and all its subscriptions."""
        await super().close_session(True)

    async def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        """Read attributes; values that became stale while this process was held up are withdrawn first."""
        self._check_number(params.NodesToRead)
        _check_timestamps(params.TimestampsToReturn)
        if not params.MaxAge >= 0:
            raise ServiceError(ua.StatusCodes.BadMaxAgeInvalid)
        await self.iserver.withdraw_stale()
        values = zip(params.NodesToRead, await super().read(params), strict=True)
        return [_as_wanted(node, value, params.TimestampsToReturn) for node, value in values]

    async def browse(self, params: ua.BrowseParameters) -> list[ua.BrowseResult]:
        """Browse nodes."""
        self._check_number(params.NodesToBrowse)
        if params.View.ViewId != ua.NodeId():
            raise ServiceError(ua.StatusCodes.BadViewIdUnknown)
        results = await super().browse(params)
        for wanted, result in zip(params.NodesToBrowse, results, strict=True):
            if result.StatusCode.is_good() and not wanted.BrowseDirection <= ua.BrowseDirection.Both:
                result.StatusCode = ua.StatusCode(ua.StatusCodes.BadBrowseDirectionInvalid)
            elif result.StatusCode.is_good() and not _is_reference_type(self.aspace, wanted.ReferenceTypeId):
                result.StatusCode = ua.StatusCode(ua.StatusCodes.BadReferenceTypeIdInvalid)
        return _renamed(results)

    async def translate_browsepaths_to_nodeids(
        self, params: list[ua.BrowsePath]
    ) -> list[ua.BrowsePathResult]:
        """Find nodes by their paths."""
        self._check_number(params)
        return _renamed(await super().translate_browsepaths_to_nodeids(params))

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        """Refuse all writes of clients, whatever the standard's nodes declare."""
        self._check_number(params.NodesToWrite)
        return [ua.StatusCode(ua.StatusCodes.BadNotWritable)] * len(params.NodesToWrite)

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        """Call a method of the object that is named; none of ours has arguments."""
        self._check_number(params, MAX_METHODS)
        wanted, refused = params[0], None
        place = self.aspace.get(wanted.ObjectId)
        if place is None:
            refused = ua.StatusCodes.BadNodeIdUnknown
        elif not any(
            each.NodeId == wanted.MethodId and each.NodeClass == ua.NodeClass.Method
            for each in place.references
        ):
            refused = ua.StatusCodes.BadMethodInvalid
        elif wanted.InputArguments:
            refused = ua.StatusCodes.BadTooManyArguments
        if refused is not None:
            return [ua.CallMethodResult(StatusCode=ua.StatusCode(refused))]
        caller.set(f"opcua {self.name[0]}" + (f", {self.user.name}" if self.user.name else ""))
        return await super().call(params)

    async def history_read(self, params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
        """Read stored values."""
        self._check_number(params.NodesToRead, MAX_HISTORY_NODES)
        _check_timestamps(params.TimestampsToReturn, ua.TimestampsToReturn.Both)
        results = await self.iserver.read_history(params)
        unknown = ua.HistoryReadResult(StatusCode=ua.StatusCode(ua.StatusCodes.BadNodeIdUnknown))
        nodes = zip(params.NodesToRead, results, strict=True)
        return [result if node.NodeId in self.aspace else unknown for node, result in nodes]

    async def create_subscription(
        self,
        params: ua.CreateSubscriptionParameters,
        callback: Callable[..., Any],
        request_callback: Callable[..., Any] | None = None,
    ) -> ua.CreateSubscriptionResult:
        """Subscribe; interval and lifetime are revised so that the subscription ends with its client."""
        if len(self._own()) >= MAX_SUBSCRIPTIONS:
            self.iserver.refuse("subscriptions")
            raise ServiceError(ua.StatusCodes.BadTooManySubscriptions)
        wanted_ms = params.RequestedPublishingInterval
        interval_ms = wanted_ms if math.isfinite(wanted_ms) else MIN_PUBLISHING_INTERVAL_MS
        interval_ms = min(max(interval_ms, MIN_PUBLISHING_INTERVAL_MS), MAX_PUBLISHING_INTERVAL_MS)
        lifetime = max(int(1000 * SESSION_TIMEOUT_S / interval_ms), 3)
        params.RequestedPublishingInterval = interval_ms
        params.RequestedLifetimeCount = min(params.RequestedLifetimeCount or lifetime, lifetime)
        params.RequestedMaxKeepAliveCount = min(params.RequestedMaxKeepAliveCount or lifetime, lifetime // 3)
        return await super().create_subscription(params, callback, request_callback)

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """Monitor attributes of nodes."""
        self._check_own(params.SubscriptionId)
        self._check_number(params.ItemsToCreate)
        _check_timestamps(params.TimestampsToReturn)
        held = len(self.items)
        asked, results = params.ItemsToCreate, list[ua.MonitoredItemCreateResult]()
        for item in asked:
            if held + len(results) >= MAX_MONITORED_ITEMS:
                self.iserver.refuse("monitored_items")
                refused = ua.StatusCodes.BadTooManyMonitoredItems
            elif not _is_possible(item.RequestedParameters.Filter, item.ItemToMonitor.AttributeId):
                refused = ua.StatusCodes.BadMonitoredItemFilterUnsupported
            elif (impossible := _impossible_part(item.ItemToMonitor)) is not None:
                refused = impossible
            else:
                params.ItemsToCreate = [item]
                results += await super().create_monitored_items(params)
                if results[-1].StatusCode.is_good():
                    numbers = params.SubscriptionId, results[-1].MonitoredItemId
                    self._items[numbers] = item.ItemToMonitor.AttributeId
                continue
            results.append(ua.MonitoredItemCreateResult(ua.StatusCode(refused)))
        return results

    async def modify_monitored_items(
        self, params: ua.ModifyMonitoredItemsParameters
    ) -> list[ua.MonitoredItemModifyResult]:
        """Change monitored items; asyncua itself accepts a queue of any length here."""
        self._check_own(params.SubscriptionId)
        self._check_number(params.ItemsToModify)
        for item in params.ItemsToModify:
            wanted = item.RequestedParameters
            attribute = self._items.get((params.SubscriptionId, item.MonitoredItemId))
            if attribute is None:
                raise ServiceError(ua.StatusCodes.BadMonitoredItemIdInvalid)
            if not _is_possible(wanted.Filter, attribute):
                raise ServiceError(ua.StatusCodes.BadMonitoredItemFilterUnsupported)
            wanted.QueueSize = min(wanted.QueueSize or MAX_QUEUED_VALUES, MAX_QUEUED_VALUES)
        return await super().modify_monitored_items(params)

    async def delete_monitored_items(self, params: ua.DeleteMonitoredItemsParameters) -> list[ua.StatusCode]:
        """Delete monitored items."""
        self._check_own(params.SubscriptionId)
        for number in params.MonitoredItemIds:
            self._items.pop((params.SubscriptionId, number), None)
        return await super().delete_monitored_items(params)

    async def set_monitoring_mode(self, params: ua.SetMonitoringModeParameters) -> list[ua.StatusCode]:
        """Set the monitoring mode of items."""
        self._check_own(params.SubscriptionId)
        return await super().set_monitoring_mode(params)

    async def set_publishing_mode(self, params: ua.SetPublishingModeParameters) -> list[ua.StatusCode]:
        """Set the publishing mode of subscriptions."""
        self._check_own(*params.SubscriptionIds)
        return await super().set_publishing_mode(params)

    def modify_subscription(self, params: ua.ModifySubscriptionParameters) -> ua.ModifySubscriptionResult:
        """Return the present parameters of the subscription; asyncua changes nothing."""
        self._check_own(params.SubscriptionId)
        return super().modify_subscription(params)

    async def delete_subscriptions(self, ids: list[int]) -> list[ua.StatusCode]:
        """End subscriptions."""
        self._check_own(*ids)
        return await super().delete_subscriptions(ids)

    def republish(self, params: ua.RepublishParameters) -> ua.NotificationMessage:
        """Send a message again; asyncua forgets it then, and sends an empty one for any other number."""
        self._check_own(params.SubscriptionId)
        kept = self._own()[params.SubscriptionId]._not_acknowledged_results  # noqa: SLF001
        if (found := kept.get(params.RetransmitSequenceNumber)) is None:
            raise ServiceError(ua.StatusCodes.BadMessageNotAvailable)
        message: ua.NotificationMessage = found.NotificationMessage
        return message

    async def transfer_subscriptions(
        self, params: ua.TransferSubscriptionsParameters, callback: Callable[..., Any]
    ) -> list[ua.TransferResult]:
        """Refuse: subscriptions stay with their sessions; a client that reconnects activates its own."""
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)

    def _own(self) -> dict[int, Any]:
        subscriptions = self.subscription_service.subscriptions.items()
        return {number: each for number, each in subscriptions if each.session_id == self.session_id}

    def _check_own(self, *ids: int) -> None:
        if not set(ids) <= self._own().keys():
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)

    def _check_number(self, operations: list[Any] | None, most: int = MAX_OPERATIONS) -> None:
        if not operations or len(operations) > most:
            self.iserver.refuse("operations")
            code = ua.StatusCodes.BadTooManyOperations if operations else ua.StatusCodes.BadNothingToDo
            raise ServiceError(code)


def _is_reference_type(space: AddressSpace, node: ua.NodeId) -> bool:
    """Whether it is a type of references, or null, which means all."""
    about = space.get(node)
    if about is None:
        return node == ua.NodeId()
    return about.attributes[ua.AttributeIds.NodeClass].value.Value.Value == ua.NodeClass.ReferenceType


def _check_timestamps(wanted: int, last: int = ua.TimestampsToReturn.Neither) -> None:
    if not wanted <= last:
        raise ServiceError(ua.StatusCodes.BadTimestampsToReturnInvalid)


def _impossible_part(wanted: ua.ReadValueId) -> int | None:
    """Return why a part or an encoding of a value is refused: asyncua would give the whole one."""
    if wanted.IndexRange:
        return ua.StatusCodes.BadIndexRangeNoData
    encoding, is_value = wanted.DataEncoding.Name, wanted.AttributeId == ua.AttributeIds.Value
    if encoding and not (is_value and encoding == "Default Binary"):
        return ua.StatusCodes.BadDataEncodingInvalid
    return None


def _as_wanted(wanted: ua.ReadValueId, value: ua.DataValue, stamps: ua.TimestampsToReturn) -> ua.DataValue:
    """Return a value with the timestamps that are wanted, or the reason why there is none."""
    if value.StatusCode.is_good() and (refused := _impossible_part(wanted)) is not None:
        return ua.DataValue(StatusCode=ua.StatusCode(refused))
    kinds = ua.TimestampsToReturn
    left_out = {} if stamps in (kinds.Source, kinds.Both) else {"SourceTimestamp": None}
    left_out |= {} if stamps in (kinds.Server, kinds.Both) else {"ServerTimestamp": None}
    return dataclasses.replace(value, **left_out)


Result = TypeVar("Result", ua.BrowseResult, ua.BrowsePathResult)


def _renamed(results: list[Result]) -> list[Result]:
    """Return results in which nodes that are not there are unknown; asyncua calls them invalid."""
    for each in results:
        if each.StatusCode.value == ua.StatusCodes.BadNodeIdInvalid:
            each.StatusCode = ua.StatusCode(ua.StatusCodes.BadNodeIdUnknown)
    return results


def _is_possible(wanted: Any, attribute: int) -> bool:
    """Whether a filter is one that loses nothing: a DataChangeFilter without a deadband.

    It checks attributes: asyncua has two classes of that name, and decodes into the other one.
    """
    if attribute == ua.AttributeIds.EventNotifier:
        return hasattr(wanted, "SelectClauses")
    return not wanted or getattr(wanted, "DeadbandType", None) == ua.DeadbandType.None_
