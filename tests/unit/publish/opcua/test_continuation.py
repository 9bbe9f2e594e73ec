"""HistoryRead: every value of a span once, in both directions, whatever the clock did."""

import struct
from collections.abc import AsyncIterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast
from unittest.mock import Mock

import pytest
from asyncua import ua
from support import history as past

from altd.history.history import History
from altd.history.records import ClockSet
from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.opcua import history as opcua_history
from altd.publish.opcua.history import StoredValues

SECONDS = 20
NOTHING_GIVEN = {"StartTime": None, "EndTime": None, "NumValuesPerNode": 0}


class _Empty:
    asked = 0

    async def ask(self, read: object) -> list[Any]:
        self.asked += 1
        return []


@pytest.mark.parametrize(
    ("point", "is_asked"),
    [
        (struct.pack(">QQ", 1, 1), True),
        (struct.pack(">QQ", 2**62 - 1, 2**62 - 1), True),
        (struct.pack(">QQ", 1, 2**62), False),
        (struct.pack(">QQ", 2**64 - 1, 1), False),
        (b"\1", False),
        (b"\0" * 17, False),
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
    expected = ua.StatusCodes.GoodNoData if is_asked else ua.StatusCodes.BadContinuationPointInvalid
    assert result.StatusCode.value == expected


def record(folder: Path, *first_s: int) -> list[tuple[float, float]]:
    """Seconds from each of these on, with 20 values each; the clock is set between them.

    Times and values in the order of time, of one time in the order of arrival.
    """
    made = []
    writing = past.store(folder)
    for number, begin_s in enumerate(first_s):
        for second in range(SECONDS):
            xs_mm = [number + 0.001 * (20 * second + n) for n in range(20)]
            is_set = [ClockSet(round(begin_s * past.US))] if number and not second else []
            samples = [past.sample(begin_s + second + n / 20, x) for n, x in enumerate(xs_mm)]
            writing.write(past.batch(begin_s + second + 1.6, [*is_set, *samples]))
            made += [(round(begin_s + second + n / 20, 3), round(x, 4)) for n, x in enumerate(xs_mm)]
    writing.end(None)
    return sorted(made, key=lambda each: each[0])


async def read_all(stored: StoredValues, **span: Any) -> list[tuple[float, float]]:
    """All values of a request with its continuations."""
    details = ua.ReadRawModifiedDetails(IsReadModified=False, **NOTHING_GIVEN | span)
    node, found = ua.HistoryReadValueId(NodeId=ua.NodeId("x_mm", 2)), list[tuple[float, float]]()
    while True:
        wanted = ua.HistoryReadParameters(details, ReleaseContinuationPoints=False, NodesToRead=[node])
        (result,) = await stored.read(wanted)
        assert result.StatusCode.is_good(), result.StatusCode
        values = result.HistoryData.DataValues
        found += [(round(each.SourceTimestamp.timestamp(), 3), each.Value.Value) for each in values]
        if not result.ContinuationPoint:
            return found
        node.ContinuationPoint = result.ContinuationPoint


def at(t_s: float) -> datetime:
    return datetime.fromtimestamp(round(t_s * 1e6) / 1e6, UTC)


@pytest.fixture(params=[(0,), (0, -60), (0, 200, -30, 30)], ids=["steady", "set back", "set often"])
async def recorded(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> AsyncIterator[tuple[StoredValues, list[tuple[float, float]]]]:
    """Stored values and what they are; an answer has at most 70."""
    monkeypatch.setattr(opcua_history, "MAX_VALUES", 70)
    monkeypatch.setattr(opcua_history, "_ROWS_AT_ONCE", 33)
    made = record(tmp_path, *(past.START_S + begin for begin in request.param))
    history = History(tmp_path / "history.db")
    start = Mock(quantities=QUANTITIES, targets={})
    yield StoredValues(history, start, lambda _: "x_mm"), made
    await history.end()


async def test_every_value_of_a_span_comes_once_in_the_order_of_time(
    recorded: tuple[StoredValues, list[tuple[float, float]]],
) -> None:
    stored, made = recorded
    first, last = at(made[0][0]), at(made[-1][0])
    assert await read_all(stored, StartTime=first, EndTime=last) == made
    backwards = await read_all(stored, StartTime=last, EndTime=first)
    assert [t_s for t_s, _ in backwards] == [t_s for t_s, _ in reversed(made)]
    assert sorted(backwards) == sorted(made)
    middle = [each for each in made if past.START_S + 5 <= each[0] <= past.START_S + 15]
    span = {"StartTime": at(past.START_S + 5), "EndTime": at(past.START_S + 15)}
    assert await read_all(stored, **span) == middle
    assert await read_all(stored, **span, NumValuesPerNode=9) == middle[:9]


async def test_the_last_and_the_first_values_are_found(
    recorded: tuple[StoredValues, list[tuple[float, float]]],
) -> None:
    """OPC 10000-11, 6.5.3: end and number alone give the newest first."""
    stored, made = recorded
    end = at(made[-1][0] + 1000)
    found = await read_all(stored, EndTime=end, NumValuesPerNode=5)
    assert [t_s for t_s, _ in found] == [t_s for t_s, _ in made[:-6:-1]]
    found = await read_all(stored, StartTime=at(0), NumValuesPerNode=5)
    assert [t_s for t_s, _ in found] == [t_s for t_s, _ in made[:5]]


@pytest.mark.parametrize("span", [{}, {"StartTime": at(9)}, {"EndTime": at(9)}, {"NumValuesPerNode": 9}])
async def test_two_of_start_end_and_number_are_needed(span: dict[str, Any]) -> None:
    stored = StoredValues(cast("Any", _Empty()), Mock(quantities=Mock(of_unit=())), lambda _: "x_mm")
    details = ua.ReadRawModifiedDetails(IsReadModified=False, **NOTHING_GIVEN | span)
    node = ua.HistoryReadValueId(NodeId=ua.NodeId("x_mm", 2))
    wanted = ua.HistoryReadParameters(details, ReleaseContinuationPoints=False, NodesToRead=[node])
    (result,) = await stored.read(wanted)
    assert result.StatusCode.value == ua.StatusCodes.BadHistoryOperationInvalid
