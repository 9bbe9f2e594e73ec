"""A continuation point is a client's own bytes: only ids that a history may have are asked for."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, cast
from unittest.mock import Mock

import pytest
from asyncua import ua

from altd.publish.opcua.history import StoredValues


class _Empty:
    asked = 0

    async def ask(self, read: object) -> list[Any]:
        self.asked += 1
        return []


@pytest.mark.parametrize(
    ("point", "is_asked"),
    [
        ((1).to_bytes(8, "big"), True),
        ((2**62 - 1).to_bytes(8, "big"), True),
        ((2**62).to_bytes(8, "big"), False),
        ((2**64 - 1).to_bytes(8, "big"), False),
        (b"\1", False),
        (b"\0" * 9, False),
    ],
)
async def test_only_an_id_that_may_exist_is_asked_for(point: bytes, is_asked: bool) -> None:
    history, start = _Empty(), Mock(quantities=Mock(of_unit=()))
    span = ua.ReadRawModifiedDetails(
        StartTime=datetime(2026, 11, 1, tzinfo=UTC),
        EndTime=datetime(2026, 11, 2, tzinfo=UTC),
        IsReadModified=False,
        NumValuesPerNode=10,
    )
    node = ua.HistoryReadValueId(NodeId=ua.NodeId("x_mm", 2), ContinuationPoint=point)
    wanted = ua.HistoryReadParameters(span, ReleaseContinuationPoints=False, NodesToRead=[node])
    stored = StoredValues(cast("Any", history), start, lambda _: "x_mm")
    (result,) = await stored.read(wanted)
    assert history.asked == is_asked
    expected = ua.StatusCodes.GoodNoData if is_asked else ua.StatusCodes.BadHistoryOperationInvalid
    assert result.StatusCode.value == expected
