"""HistoryRead of raw values: the measurements of the unit's history file, with their original quality."""

from __future__ import annotations

import bisect
import functools
import heapq
import itertools
import math
import struct
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime, timedelta

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
_CONTINUATION = struct.Struct(">QQ")
"""Time and id of the next measurement: the server stores nothing for clients that do not continue."""

_ROWS_AT_ONCE = 200
_Key = tuple[int, int]
"""Time, µs since 1970, and id of a measurement."""


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
            codes = ua.StatusCodes
            point, invalid = codes.BadContinuationPointInvalid, codes.BadHistoryOperationInvalid
            return _failed(point if node.ContinuationPoint else invalid)
        try:
            rows = await self._history.ask(span.read)
        except NoHistoryError:
            return _failed(ua.StatusCodes.BadNoDataAvailable)
        found, further = rows[: span.count], rows[span.count :]
        result, data = ua.HistoryReadResult(), ua.HistoryData()
        data.DataValues = [self._value(row, key) for row in found]
        result.HistoryData = data
        if further and span.is_limited_by_server:
            result.ContinuationPoint = _CONTINUATION.pack(*_key(further[0]))
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
    """The span of a request, at most ``count`` values; backwards from a later start, or without a start.

    Raises ValueError without two of start, end and number (OPC 10000-11, 6.5.3).
    """

    def __init__(self, details: ua.ReadRawModifiedDetails, continuation: bytes | None) -> None:
        start, end, wanted = _us(details.StartTime), _us(details.EndTime), details.NumValuesPerNode
        if (start is not None) + (end is not None) + bool(wanted) < 2:
            raise ValueError
        self._is_reverse = start is None or (end is not None and end < start)
        first_us, last_us = (end, start) if self._is_reverse and start is not None else (start, end)
        self._first: _Key = (first_us or 0, 0)
        self._last: _Key = (2**62 if last_us is None else last_us, 2**62)
        if continuation:
            if len(continuation) != _CONTINUATION.size:
                raise ValueError
            t_us, number = _CONTINUATION.unpack(continuation)
            if max(t_us, number) >= 2**62:
                raise ValueError
            if self._is_reverse:
                self._last = min(self._last, (t_us, number))
            else:
                self._first = max(self._first, (t_us, number))
        self.count = min(wanted or MAX_VALUES, MAX_VALUES)
        self.is_limited_by_server = not wanted or wanted > MAX_VALUES

    def read(self, reader: Reader) -> Sequence[StoredMeasurement]:
        """Return the rows in the order of their times, and one more row if there is one.

        Only within an epoch are ids in the order of times: after the clock was set back, times come again.
        """
        rows = [self._rows(reader, *epoch) for epoch in _epochs(reader)]
        merged = heapq.merge(*rows, key=_key, reverse=self._is_reverse)
        return list(itertools.islice(merged, self.count + 1))

    def _rows(self, reader: Reader, first: int, last: int) -> Iterator[StoredMeasurement]:
        """Yield the rows of an epoch with these ids, by bisection: the file has no index of times."""
        ids = range(first, last + 1)
        key = functools.partial(_key_from, reader, last)
        first += bisect.bisect_left(ids, self._first, key=key)
        last = ids.start + bisect.bisect_right(ids, self._last, key=key) - 1
        while rows := reader.measurements_between(first, last, _ROWS_AT_ONCE, newest_first=self._is_reverse):
            yield from rows
            first, last = (first, rows[-1].id - 1) if self._is_reverse else (rows[-1].id + 1, last)


def _key(row: StoredMeasurement) -> _Key:
    return row.t_us, row.id


def _key_from(reader: Reader, last: int, number: int) -> _Key:
    """Key of the first measurement from an id on; later than any other if there is none."""
    rows = reader.measurements_between(number, last, 1)
    return _key(rows[0]) if rows else (2**63, 0)


def _epochs(reader: Reader) -> Iterator[tuple[int, int]]:
    """Yield first and last id of the measurements of each epoch of the clock."""
    ((low, high),) = reader.rows("SELECT min(id), max(id) FROM measurements")

    def epoch_from(number: int) -> float:
        rows = reader.measurements_between(number, high, 1)
        return rows[0].epoch if rows else math.inf

    while low is not None and low <= high:
        ids = range(low, high + 1)
        after = low + bisect.bisect_right(ids, epoch_from(low), key=epoch_from)
        yield low, after - 1
        low = after


def _us(time: datetime | None) -> int | None:
    """Return a time of a request; None: it is not given."""
    if time is None or time <= _WINDOWS_EPOCH:
        return None
    return max((time - _EPOCH) // timedelta(microseconds=1), 0)


def _failed(code: int) -> ua.HistoryReadResult:
    return ua.HistoryReadResult(StatusCode=ua.StatusCode(code))
