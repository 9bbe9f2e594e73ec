"""HistoryRead of raw values: the measurements of the unit's history file, with their original quality."""

from __future__ import annotations

import bisect
import struct
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from asyncua import ua

from altd.history.history import History, NoHistoryError
from altd.history.reader import Reader
from altd.history.records import StoredMeasurement
from altd.publish.opcua.quality import status_of
from altd.publish.opcua.start import Start

MAX_VALUES = 2000
"""Maximum number of values of one node in one answer; the rest follows at its continuation point."""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_WINDOWS_EPOCH = datetime(1601, 1, 1, tzinfo=UTC)
_CONTINUATION = struct.Struct(">Q")
"""Id of the next measurement: the server stores nothing for clients that do not continue."""


class StoredValues:
    """Answers requests from the file. ``key_of`` names the quantity of a node; None: it has no history."""

    def __init__(self, history: History, start: Start, key_of: Callable[[ua.NodeId], str | None]) -> None:
        self._history = history
        self._start = start
        self._places = {each.key: each.place for each in start.quantities.of_unit}
        self._key_of = key_of

    async def read(self, params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
        """Return the results of a request, one per node."""
        return [await self._result(params, node) for node in params.NodesToRead]

    async def _result(
        self, params: ua.HistoryReadParameters, node: ua.HistoryReadValueId
    ) -> ua.HistoryReadResult:
        details, key = params.HistoryReadDetails, self._key_of(node.NodeId)
        if key is None or not isinstance(details, ua.ReadRawModifiedDetails) or details.IsReadModified:
            return _failed(ua.StatusCodes.BadHistoryOperationUnsupported)
        if params.ReleaseContinuationPoints:
            return ua.HistoryReadResult()
        try:
            span = _Span(details, node.ContinuationPoint)
        except ValueError:
            return _failed(ua.StatusCodes.BadHistoryOperationInvalid)
        try:
            rows = await self._history.ask(span.read)
        except NoHistoryError:
            return _failed(ua.StatusCodes.BadNoDataAvailable)
        found, further = rows[: span.count], rows[span.count :]
        result, data = ua.HistoryReadResult(), ua.HistoryData()
        data.DataValues = [self._value(row, key) for row in found]
        result.HistoryData = data
        if further and span.is_limited_by_server:
            result.ContinuationPoint = _CONTINUATION.pack(further[0].id)
        if not found:
            result.StatusCode = ua.StatusCode(ua.StatusCodes.GoodNoData)
        return result

    def _value(self, row: StoredMeasurement, key: str) -> ua.DataValue:
        value, target = row.values.get(key), key.rpartition(".")[0] or self._places.get(key, "")
        place = target if self._start.quantities.has_places else None
        is_known = row.valid and value is not None
        status = status_of(is_known, row.status, self._start.targets, has_time=True, place=place)
        return ua.DataValue(
            ua.Variant(None if status.is_bad else value),
            StatusCode=ua.StatusCode(status),
            SourceTimestamp=_EPOCH + timedelta(microseconds=row.t_us),
        )


class _Span:
    """The span of a request: from a start to an end, at most ``count`` values.

    Raises ValueError if it cannot be answered: backwards, without a start, or without both end and count.
    """

    def __init__(self, details: ua.ReadRawModifiedDetails, continuation: bytes | None) -> None:
        start, end = details.StartTime, details.EndTime
        self._from_us = _us(start)
        has_end = end is not None and end > _WINDOWS_EPOCH
        self._to_us = _us(end) if has_end else 2**62
        wanted = details.NumValuesPerNode
        if start is None or start <= _WINDOWS_EPOCH or self._to_us < self._from_us or not (has_end or wanted):
            raise ValueError
        self._first_id: int | None = None
        if continuation:
            if len(continuation) != _CONTINUATION.size:
                raise ValueError
            (self._first_id,) = _CONTINUATION.unpack(continuation)
            if self._first_id >= 2**62:
                raise ValueError
        self.count = min(wanted or MAX_VALUES, MAX_VALUES)
        self.is_limited_by_server = not wanted or wanted > MAX_VALUES

    def read(self, reader: Reader) -> Sequence[StoredMeasurement]:
        """Return the rows, and one more row if there is one."""
        first = self._first_id
        if first is None:
            first = _first_id(reader, self._from_us)
        rows = reader.measurements_after(max(first - 1, 0), self.count + 1)
        return [row for row in rows if self._from_us <= row.t_us <= self._to_us]


def _first_id(reader: Reader, from_us: int) -> int:
    """Id of the first measurement that is not older, by bisection: the file has no index of times.

    Measurements are in the order of their creation; if the clock was set back, it is one of them.
    """
    ((low, high),) = reader.rows("SELECT min(id), max(id) FROM measurements")
    if low is None:
        return 0

    def time_us(number: int) -> int:
        rows: list[Any] = reader.measurements_after(number - 1, 1)
        return rows[0].t_us if rows else from_us

    return low + bisect.bisect_left(range(low, high + 1), from_us, key=time_us)


def _us(time: datetime | None) -> int:
    return 0 if time is None else max((time - _EPOCH) // timedelta(microseconds=1), 0)


def _failed(code: int) -> ua.HistoryReadResult:
    return ua.HistoryReadResult(StatusCode=ua.StatusCode(code))
