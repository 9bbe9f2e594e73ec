"""Trends against sums made in the test, and what bounds a query."""

import asyncio
import math
import random
import sqlite3
import statistics
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.history import START_S, US, batch, event, recorded, sample, state, store, write_seconds

from altd.history import history as history_module
from altd.history.history import MAX_WAITING, History, NoHistoryError
from altd.history.reader import MAX_POINTS, MAX_ROWS, Reader

SECONDS = 3 * 3600


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[float | None]]:
    """Three hours of one measurement a second, and what was measured."""
    folder = tmp_path_factory.mktemp("history")
    draw = random.Random(5)
    xs = [None if draw.random() < 0.1 else round(draw.uniform(-50, 50), 4) for _ in range(SECONDS)]
    writing = store(folder)
    for begin in range(0, SECONDS, 600):
        items = []
        for t_s in range(begin, begin + 600):
            ill = (2, "front_spot_missing") if xs[t_s] is None else (0, "")
            items += [state(START_S + t_s + 0.2, *ill), sample(START_S + t_s + 0.2, xs[t_s], t_s)]
        writing.write(batch(START_S + begin + 601, items))
    writing.end(None)
    return folder / "history.db", xs


@pytest.mark.parametrize(
    ("seconds", "points", "source", "step_s"),
    [
        (SECONDS, 3, "hours", 3600),
        (SECONDS, 90, "minutes", 120),
        (SECONDS, 180, "minutes", 60),
        (SECONDS, 1000, "seconds", 11),
        (600, 1000, "seconds", 1),
        (SECONDS, 1, "hours", SECONDS),
    ],
)
def test_a_trend_is_what_the_measurements_give(
    written: tuple[Path, list[float | None]], seconds: int, points: int, source: str, step_s: int
) -> None:
    path, xs = written
    with Reader(path) as reader:
        trend = reader.trend(START_S * US, (START_S + seconds) * US, points, ["x_mm"])
    assert (trend.source, trend.span_us) == (source, step_s * US)
    assert len(trend.points) == math.ceil(seconds / step_s) <= points
    for number, point in enumerate(trend.points):
        assert point.t_us == (START_S + number * step_s) * US
        measured = xs[number * step_s : min((number + 1) * step_s, seconds)]
        valid = [x for x in measured if x is not None]
        assert (point.n, point.n_valid) == (len(measured), len(valid))
        assert point.lost_to == ("front_spot_missing" if len(valid) < len(measured) else "")
        assert point.worst == (2 if len(valid) < len(measured) else 0)
        if not valid:
            assert point.values == {}
            continue
        x = point.values["x_mm"]
        assert x.mean == pytest.approx(statistics.fmean(valid), abs=1.1e-4)
        assert (x.low, x.high) == (min(valid), max(valid))
        assert x.sigma == 0.004


def test_it_holds_what_was_asked_for(written: tuple[Path, list[float | None]]) -> None:
    with Reader(written[0]) as reader:
        (point,) = reader.trend(START_S * US, (START_S + 60) * US, 1, ["yaw_deg", "x_mm"]).points
        assert list(point.values) == ["yaw_deg", "x_mm"]
        assert reader.trend(0, 1000 * US, 10).points == ()


def test_the_worst_of_a_point_is_the_most_severe_of_its_seconds(tmp_path: Path) -> None:
    states = [state(START_S, 4, "stale"), state(START_S + 1, 2, "unsteady")]
    with recorded(tmp_path, batch(START_S + 3, states)) as reader:
        (point,) = reader.trend(START_S * US, (START_S + 2) * US, 1, ["x_mm"]).points
    assert (point.worst, point.worst_code) == (4, "stale")


@pytest.mark.parametrize(
    ("from_us", "to_us", "points", "keys"),
    [
        (5, 5, 10, None),
        (-1, 5, 10, None),
        (0, 2**63, 10, None),
        (0, 5, 0, None),
        (0, 5, MAX_POINTS + 1, None),
        (0, 5, 10, ["x_mm; DROP TABLE events"]),
        (0, 5, 10, ["roll_deg"]),
        (0, 5, 10, ["front.x_mm"]),
    ],
)
def test_what_cannot_be_asked_is_refused(
    written: tuple[Path, list[float | None]], from_us: int, to_us: int, points: int, keys: list[str] | None
) -> None:
    with Reader(written[0]) as reader, pytest.raises(ValueError, match=r"a trend is of|there is no quantity"):
        reader.trend(from_us, to_us, points, keys)


def test_measurements_are_given_from_one_on_and_no_more_than_asked(
    written: tuple[Path, list[float | None]],
) -> None:
    with Reader(written[0]) as reader:
        ((last,),) = reader.rows("SELECT max(id) FROM measurements")
        first = last - 3600
        some = reader.measurements_after(first, 10)
        assert [one.id for one in some] == list(range(some[0].id, some[0].id + 10))
        assert reader.measurements_after(some[-1].id, 1)[0].id == some[-1].id + 1
        assert reader.measurements_after(last, 10) == []
        for after, limit in ((-1, 1), (0, 0), (0, MAX_ROWS + 1), (2**70, 1)):
            with pytest.raises(ValueError, match="after an id"):
                reader.measurements_after(after, limit)


def test_a_file_has_a_name_of_its_own(tmp_path: Path) -> None:
    names = set()
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        for t_s in (START_S, START_S + 100):
            writing = store(tmp_path / name)
            writing.write(batch(t_s))
            writing.end(batch(t_s))
            with Reader(tmp_path / name / "history.db") as reader:
                names.add(reader.facts()["file"])
    assert len(names) == 2


class TestHistory:
    """Queries of the interfaces."""

    @pytest.fixture
    def path(self, tmp_path: Path) -> Path:
        writing = store(tmp_path)
        write_seconds(writing, START_S, [10.0] * 3)
        writing.write(batch(START_S + 9, [], [event(1, START_S + 1, text="first")]))
        writing.end(None)
        return tmp_path / "history.db"

    async def test_is_answered_in_a_thread(self, path: Path) -> None:
        history = History(path)
        trend = await history.ask(lambda reader: reader.trend(START_S * US, (START_S + 3) * US, 3, ["x_mm"]))
        assert [point.values["x_mm"].mean for point in trend.points] == [10.0] * 3
        assert len(await history.ask(lambda reader: reader.measurements_after(50, 100))) == 10
        assert (await history.ask(lambda reader: reader.events(0, 2**62, ["state"])))[0].text == "first"
        with pytest.raises(ValueError, match="there is no quantity"):
            await history.ask(lambda reader: reader.trend(0, 1, 1, ["no"]))
        await history.end()

    async def test_without_one_it_says_why(self) -> None:
        history = History(None, "the history is off: no folder")
        with pytest.raises(NoHistoryError, match="off: no folder"):
            await history.ask(lambda reader: reader.events(0, 1))
        await history.end()

    async def test_a_file_that_is_gone_damaged_or_foreign_is_a_sentence(self, path: Path) -> None:
        history = History(path)
        spoil(path)
        with pytest.raises(NoHistoryError, match="the history cannot be read: file is not a database"):
            await history.ask(lambda reader: reader.events(0, 1))
        remove(path)
        with pytest.raises(NoHistoryError, match="the history cannot be read: No such file"):
            await history.ask(lambda reader: reader.events(0, 1))
        await history.end()

    async def test_a_query_that_takes_too_long_is_given_up(
        self, written: tuple[Path, list[float | None]], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(history_module, "QUERY_TIMEOUT_S", 0.001)
        monkeypatch.setattr(history_module, "MAX_WAITING", 10_000)
        history = History(written[0])
        with pytest.raises(NoHistoryError, match=r"the query was given up: it took more than 0\.001 s"):
            await history.ask(lambda reader: reader.trend(START_S * US, (START_S + SECONDS) * US, 5000))
        monkeypatch.setattr(history_module, "QUERY_TIMEOUT_S", 2.0)
        assert (await history.ask(lambda reader: reader.trend(START_S * US, (START_S + 60) * US, 1))).points
        await history.end()

    async def test_no_more_than_some_wait(self, path: Path) -> None:
        history, may_go = History(path), threading.Event()
        asked = (history.ask(lambda reader: may_go.wait(60)) for _ in range(MAX_WAITING))
        waiting = [asyncio.create_task(each) for each in asked]
        await asyncio.sleep(0.05)
        with pytest.raises(NoHistoryError, match=f"{MAX_WAITING} ask the history already"):
            await history.ask(lambda reader: reader.events(0, 1))
        may_go.set()
        assert await asyncio.gather(*waiting) == [True] * MAX_WAITING
        assert history.waiting == 0
        await history.end()

    async def test_writing_goes_on_while_it_is_asked(self, tmp_path: Path) -> None:
        writing = store(tmp_path)
        writing.write(batch(START_S + 1, [sample(START_S, sequence=1)]))
        history = History(tmp_path / "history.db")

        def read_while_writing(reader: Reader) -> list[int]:
            with in_transaction(tmp_path / "history.db"):
                writing.write(batch(START_S + 2, [sample(START_S + 1, sequence=2)]))
            return [one.sequence for one in reader.measurements_after(0, 10)]

        assert await history.ask(read_while_writing) == [1, 2]
        writing.end(None)
        await history.end()


def spoil(path: Path) -> None:
    path.write_bytes(b"x" * 5000)


def remove(path: Path) -> None:
    path.unlink()


@contextmanager
def in_transaction(path: Path) -> Iterator[None]:
    """Another program reads."""
    foreign = sqlite3.connect(path, isolation_level=None)
    foreign.execute("BEGIN")
    foreign.execute("SELECT count(*) FROM events").fetchone()
    yield
    foreign.execute("COMMIT")
    foreign.close()
