"""The unit's history over HTTP: trends, events, and a stream that continues where it broke off."""

import asyncio
import json
from collections.abc import AsyncGenerator, AsyncIterator, Iterable
from contextlib import aclosing
from pathlib import Path
from typing import Any

import pytest
from support.history import START_S, WallClock, at, batch, event, sample, store

from altd.history.history import History
from altd.publish.http import stream
from altd.status.board import Board
from altd.status.unit import PublishedUnit

from .conftest import DOCUMENT, Unit, fits, served_with

MONOTONIC_NS = 10**12
"""When ``START_S`` was, on the clock of ``support.history``."""


@pytest.fixture
def clock() -> WallClock:
    return WallClock(MONOTONIC_NS)


@pytest.fixture
def recorded(tmp_path: Path) -> History:
    """A minute at one a second: x rises by 0.1 mm a second, the beam is lost in the last 10 s; events."""
    kept = store(tmp_path)
    measured = [sample(START_S + t, None if t >= 50 else 0.1 * t, t + 1) for t in range(60)]
    events = [event(number + 1, START_S + number, text=f"number {number}") for number in range(5)]
    kept.write(batch(START_S + 61, measured, events))
    kept.end(None)
    return History(tmp_path / "history.db")


@pytest.fixture
async def unit(
    published: PublishedUnit, recorded: History, monkeypatch: pytest.MonkeyPatch
) -> AsyncIterator[Unit]:
    monkeypatch.setattr(stream, "KEEP_ALIVE_INTERVAL_S", 0.01)
    async with served_with(published, recorded) as unit:
        yield unit


async def test_a_trend_is_what_was_measured(unit: Unit) -> None:
    path = f"/api/v1/trend?from={START_S}&to={START_S + 60}&points=6"
    answer = await unit.ask(path)
    head = await unit.ask(path, "HEAD")
    assert (head.status, head.body) == (200, b"")
    shown = fits(DOCUMENT, "/api/v1/trend", answer)
    assert (shown["source"], shown["span_s"]) == ("seconds", 10.0)
    assert shown["t_s"] == [START_S + 10.0 * point for point in range(6)]
    assert shown["n"] == [10] * 6
    assert shown["n_valid"] == [10, 10, 10, 10, 10, 0]
    x = shown["quantities"]["x_mm"]
    assert x["mean"] == [pytest.approx(1.0 * point + 0.45) for point in range(5)] + [None]
    assert x["low"] == [pytest.approx(1.0 * point) for point in range(5)] + [None]
    assert x["high"] == [pytest.approx(1.0 * point + 0.9) for point in range(5)] + [None]
    assert x["sigma"] == [0.004] * 5 + [None]
    assert shown["lost_to"][5] == "front_spot_missing"


async def test_times_may_count_from_now(unit: Unit, clock: WallClock) -> None:
    clock.now_ns += 60 * 10**9
    wall = clock.utc(clock.now_ns)
    clock.offset_s = START_S + 60 - wall.timestamp()
    whole = (await unit.ask("/api/v1/trend?points=1000")).json
    last = (await unit.ask("/api/v1/trend?from=-10")).json
    none = (await unit.ask("/api/v1/trend?from=5&to=5")).json
    before = (await unit.ask("/api/v1/trend?from=1&to=60")).json
    assert sum(whole["n"]) == 60
    assert sum(last["n"]) == 10
    assert none["t_s"] == before["t_s"] == []
    fits_columns(none)


def fits_columns(shown: dict[str, Any]) -> None:
    assert {len(column) for of in shown["quantities"].values() for column in of.values()} == {len(shown["n"])}


async def test_events_come_newest_first_and_page_by_page(unit: Unit) -> None:
    first = fits(DOCUMENT, "/api/v1/events", await unit.ask("/api/v1/events?kind=state&limit=3"))["events"]
    rest = (await unit.ask(f"/api/v1/events?kind=state&before={first[-1]['id']}")).json["events"]
    other = (await unit.ask("/api/v1/events?kind=request")).json
    all_of_them = (await unit.ask("/api/v1/events")).json["events"]
    assert [each["text"] for each in first + rest] == [f"number {n}" for n in (4, 3, 2, 1, 0)]
    assert first[0]["time"] == "2026-11-20T08:00:04.000Z"
    assert other == {"events": []}
    assert len(all_of_them) >= 5


@pytest.mark.parametrize(
    "query",
    [
        "trend?from=x",
        "trend?from=nan",
        "trend?from=inf",
        "trend?to=1e300",
        "trend?from=1&from=2",
        "trend?points=0",
        "trend?points=1001",
        "trend?points=-1",
        "trend?points=1e3",
        "trend?points=%D9%A3",
        "trend?points=99999999999999999999",
        "events?limit=501",
        "events?before=-1",
        "events?kind=state&kind=request",
    ],
)
async def test_what_cannot_be_is_named(unit: Unit, query: str) -> None:
    answer = await unit.ask(f"/api/v1/{query}")
    assert answer.status == 400
    assert query.partition("?")[2].partition("=")[0] in answer.json["error"]


@pytest.mark.parametrize("kind", ["'; DROP TABLE events; --", "state%00", "%F0%9F%92%A9"])
async def test_no_parameter_gets_into_the_sql(unit: Unit, kind: str) -> None:
    answer = await unit.ask(f"/api/v1/events?kind={kind.replace(' ', '+')}")
    assert (answer.status, "kind is invalid" in answer.json["error"]) == (400, True)
    assert len((await unit.ask("/api/v1/events?kind=state")).json["events"]) == 5


async def test_without_a_history_it_says_why(published: PublishedUnit, tmp_path: Path) -> None:
    async with served_with(published, None) as unit:
        for path in ("/api/v1/trend", "/api/v1/events"):
            answer = await unit.ask(path)
            assert (answer.status, answer.json) == (503, {"error": "there is no history"})
    async with served_with(published, History(tmp_path / "gone.db")) as unit:
        assert (await unit.ask("/api/v1/trend")).status == 503


Event = dict[str, Any]


async def stream_of(unit: Unit, last_id: str | None) -> AsyncGenerator[Event, None]:
    """The events of a stream that is resumed: ``id``, ``event`` and ``data``, those that they have."""
    reader, writer = await unit.connect()
    header = "" if last_id is None else f"Last-Event-ID: {last_id}\r\n"
    writer.write(f"GET /api/v1/stream HTTP/1.1\r\nHost: unit\r\n{header}\r\n".encode())
    try:
        await reader.readuntil(b"\r\n\r\n")
        while True:
            size = int(await reader.readline(), 16)
            block = (await reader.readexactly(size + 2)).decode().strip()
            fields = dict(line.split(": ", 1) for line in block.split("\n"))
            if "data" in fields:
                yield {**fields, "data": json.loads(fields["data"])}
    finally:
        writer.close()


async def read(unit: Unit, last_id: str | None, count: int) -> list[Event]:
    """The next events of a stream that is resumed."""
    found: list[Event] = []
    async with aclosing(stream_of(unit, last_id)) as events:
        async for each in events:
            found.append(each)
            if len(found) == count:
                break
    return found


def ids_of(events: Iterable[Event]) -> list[str | None]:
    return [each.get("id") for each in events]


async def test_a_stream_that_broke_off_goes_on_with_what_was_missed(board: Board, unit: Unit) -> None:
    board.publish(at(START_S + 59, 5.9, 60))
    last = key(40)
    events = await read(unit, last, 20)
    now, *past = events
    assert now["data"]["sequence"] == 60
    assert "id" not in now, "whoever breaks off now would lose what is past"
    assert "event" not in now
    assert {each["event"] for each in past} == {"past"}
    assert [each["data"]["sequence"] for each in past] == list(range(41, 60))
    assert ids_of(past) == [key(sequence) for sequence in range(41, 60)]
    first, lost = past[0]["data"], past[-1]["data"]
    assert first["time"] == "2026-11-20T08:00:40.000Z"
    assert (first["valid"], first["x_mm"], first["sigma"]["x_mm"]) == (True, 4.0, 0.004)
    assert first["front"].keys() == {"x_mm", "y_mm"}
    assert (lost["valid"], lost["x_mm"], lost["status"]) == (False, None, ["front_spot_missing"])
    assert "age_s" not in first, "it would be taken for now"


def key(sequence: int) -> str:
    measurement = at(START_S + sequence - 1, 1.0, sequence)
    return f"{measurement.sequence}-{measurement.t_ns}"


async def test_once_all_has_come_events_have_ids_again(board: Board, unit: Unit, clock: WallClock) -> None:
    clock.now_ns = at(START_S + 59, 5.9, 60).t_ns
    board.publish(at(START_S + 59, 5.9, 60))
    found: list[Event] = []
    async with aclosing(stream_of(unit, key(57))) as events:
        async for each in events:
            found.append(each)
            if "id" in each and "event" not in each:
                break
            board.publish(at(START_S + 59.1, 5.9, 60 + len(found)))
    assert [each["data"]["sequence"] for each in found if "event" in each] == [58, 59]
    assert found[-1]["id"].startswith(f"{found[-1]['data']['sequence']}-")
    assert found[0]["data"]["sequence"] == 60


async def test_who_missed_nothing_gets_nothing_twice(board: Board, unit: Unit) -> None:
    board.publish(at(START_S + 59, 5.9, 60))
    without = await read(unit, None, 1)
    (again,) = await read(unit, without[0]["id"], 1)
    assert without[0]["id"] == key(60)
    assert again["data"]["sequence"] == 60


@pytest.mark.parametrize(
    ("last_id", "why"),
    [
        ("nonsense", "it is not an id of this stream"),
        ("160", "it is not an id of this stream"),
        ("1-2-3", "it is not an id of this stream"),
        ("9" * 30 + "-1", "it is not an id of this stream"),
        ("7-7", "the history does not have it"),
    ],
)
async def test_what_cannot_be_resumed_is_a_gap_that_says_why(
    board: Board, unit: Unit, last_id: str, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "MAX_WAIT_S", -1.0)
    board.publish(at(START_S + 59, 5.9, 60))
    _, gap = await read(unit, last_id, 2)
    assert (gap["event"], gap["data"]) == ("gap", {"after": last_id[:64], "why": why})


async def test_who_comes_back_before_his_last_one_is_written_misses_nothing(
    board: Board, unit: Unit, clock: WallClock, tmp_path: Path
) -> None:
    """The history writes a batch a second: what was sent last is not in it when the line breaks."""
    board.publish(at(START_S + 62, 6.2, 63))
    reading = asyncio.create_task(read(unit, key(61), 2))
    await asyncio.sleep(0.2)
    kept = store(tmp_path)
    kept.write(batch(START_S + 64, [sample(START_S + t, 0.1 * t, t + 1) for t in (60, 61, 62)]))
    kept.end(None)
    clock.now_ns += 600_000_000
    now, missed = await reading
    assert now["data"]["sequence"] == 63
    assert (missed.get("event"), missed["data"].get("sequence")) == ("past", 62)


async def test_no_history_and_one_that_lags_are_gaps(
    board: Board, published: PublishedUnit, unit: Unit, clock: WallClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "MAX_WAIT_S", -1.0)
    board.publish(at(START_S + 70, 5.9, 71))
    async with served_with(published, None) as without:
        _, gap = await read(without, key(40), 2)
        assert gap["data"]["why"] == "there is no history"
    *past, gap = (await read(unit, key(58), 4))[1:]
    assert [each["data"]["sequence"] for each in past] == [59, 60]
    assert gap["data"]["why"] == "the history does not have the newest measurements"


async def test_too_much_is_not_sent_again(board: Board, unit: Unit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "MAX_ROWS_AT_ONCE", 5)
    monkeypatch.setattr(stream, "MAX_ROWS", 12)
    board.publish(at(START_S + 59, 5.9, 60))
    events = await read(unit, key(1), 17)
    assert [each["data"]["sequence"] for each in events[1:-1]] == list(range(2, 17))
    assert events[-1]["event"] == "gap"
