"""The history holds the measurements: hand-made ones, read back through the reader and by SQL."""

import itertools
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.history import (
    ABOUT,
    START_S,
    US,
    at,
    batch,
    event,
    record_seconds,
    recorded,
    renamed,
    sample,
    state,
    store,
    write_seconds,
)

from altd.answers import export
from altd.history.columns import columns_of
from altd.history.reader import Reader
from altd.history.records import About, ClockSet, Sample
from altd.history.schema import HOURS, MINUTES, SECONDS
from altd.instruments.beam.instrument import QUANTITIES
from altd.instruments.beam.solver import KEYS
from altd.reasons import Reason
from altd.records.joint import Joint
from altd.records.sensors import Quality, SensorValue
from altd.status.event_log import EventKind


def read(folder: Path) -> Reader:
    return Reader(folder / "history.db")


def test_a_measurement_comes_back_as_it_was_published(tmp_path: Path) -> None:
    writing = store(tmp_path)
    writing.write(batch(START_S + 2, [sample(START_S + 0.25, 110.1234, 7)]))
    with read(tmp_path) as reader:
        (stored,) = reader.measurements_after(0, 10)
        assert reader.measurements_after(stored.id, 10) == []
    writing.end(None)
    assert (stored.t_us, stored.sequence, stored.frames) == (START_S * US + 250_000, 7, 20)
    assert (stored.valid, stored.status) == (True, ())
    assert stored.values == {
        "x_mm": 110.1234, "y_mm": 4.987, "yaw_deg": 1.1459, "pitch_deg": -1.7184, "yaw_mm_per_m": 20.0024,
        "pitch_mm_per_m": -30.0007, "front.x_mm": 10.012, "front.y_mm": 4.987, "rear.x_mm": 15.613,
        "rear.y_mm": -3.413,
    }  # fmt: skip
    assert stored.sigmas == {"x_mm": 0.004, "y_mm": 0.004, "yaw_deg": 0.0011, "pitch_deg": 0.0011}


def test_an_invalid_one_has_its_reasons_and_no_number(tmp_path: Path) -> None:
    with recorded(tmp_path, batch(START_S + 2, [sample(START_S, None, 7, Reason.SATURATED)])) as reader:
        (stored,) = reader.measurements_after(0, 10)
    assert (stored.valid, stored.status) == (False, ("front_saturated",))
    assert (stored.values, stored.sigmas) == ({}, {})


def test_a_summary_has_mean_and_extremes_of_the_valid_ones_alone(tmp_path: Path) -> None:
    items = [sample(START_S + 0.1, 10.0), sample(START_S + 0.2, None), sample(START_S + 0.3, 10.0009)]
    items.append(sample(START_S + 0.4, 9.9999, 1, Reason.SIMULATED))
    made = batch(START_S + 2, [state(START_S + 0.5, 2, "front_spot_missing"), *items])
    with recorded(tmp_path, made) as reader:
        for table in (SECONDS, MINUTES, HOURS):
            (row,) = reader.summaries(table, 0, 2**62)
            assert (row.t_us, row.span_us) == (START_S * US, table.span_s * US)
            assert (row.n, row.n_valid) == (4, 3)
            assert (row.worst, row.worst_code, row.lost_to) == (2, "front_spot_missing", "front_spot_missing")
            x = row.values["x_mm"]
            assert (x.mean, x.sigma, x.low, x.high) == (10.0003, 0.004, 9.9999, 10.0009)
            assert sorted(row.values) == ["pitch_deg", "x_mm", "y_mm", "yaw_deg"]


def test_a_second_without_a_valid_measurement_has_no_number(tmp_path: Path) -> None:
    with recorded(tmp_path, batch(START_S + 2, [state(START_S, 4, "stale")])) as reader:
        (row,) = reader.summaries(SECONDS, 0, 2**62)
    assert (row.n, row.n_valid, row.values, row.worst, row.worst_code) == (0, 0, {}, 4, "stale")


def test_a_second_that_comes_in_two_batches_is_one_row(tmp_path: Path) -> None:
    one = batch(START_S + 1.1, [sample(START_S + 0.1, 10.0)])
    two = batch(START_S + 1.9, [sample(START_S + 0.8, 11.0)])
    with recorded(tmp_path, one, two) as reader:
        (row,) = reader.summaries(SECONDS, 0, 2**62)
    assert (row.n, row.values["x_mm"].mean) == (2, 10.5)


def test_what_waited_for_a_slow_disk_is_written_whole(tmp_path: Path) -> None:
    items = [one for n in range(100) for one in (state(START_S + n), sample(START_S + n, 10.0 + n))]
    with recorded(tmp_path, batch(START_S + 101, items)) as reader:
        rows = list(reader.summaries(SECONDS, 0, 2**62))
        assert [row.values["x_mm"].mean for row in rows] == [10.0 + n for n in range(100)]
        assert sum(row.n for row in reader.summaries(MINUTES, 0, 2**62)) == 100


def test_minutes_hold_what_their_seconds_hold(tmp_path: Path) -> None:
    record_seconds(tmp_path, START_S, [10.0 + number * 0.01 for number in range(70)], rate=2)
    with read(tmp_path) as reader:
        first, second = reader.summaries(MINUTES, 0, 2**62)
        seconds = list(reader.summaries(SECONDS, 0, 2**62))
    assert len(seconds) == 70
    assert (first.n, second.n) == (120, 20)
    assert first.values["x_mm"].mean == pytest.approx(10.295, abs=1e-9)
    assert (first.values["x_mm"].low, first.values["x_mm"].high) == (10.0, 10.59)


def test_after_a_restart_the_same_minute_has_a_second_row_and_the_first_stays(tmp_path: Path) -> None:
    for x_mm in (10.0, 20.0):
        writing = store(tmp_path)
        writing.write(batch(START_S + 2, [sample(START_S + 0.5, x_mm)]))
        writing.end(batch(START_S + 2))
    with read(tmp_path) as reader:
        rows = list(reader.summaries(MINUTES, 0, 2**62))
        assert [row.values["x_mm"].mean for row in rows] == [10.0, 20.0]
        trend = reader.trend(START_S * US, (START_S + 60) * US, 1, ["x_mm"])
        (point,) = trend.points
        assert (point.n, point.values["x_mm"].mean, point.values["x_mm"].high) == (2, 15.0, 20.0)
        assert [stored.epoch for stored in reader.measurements_after(0, 9)] == [1, 2]


def test_a_clock_that_is_set_back_overwrites_nothing_and_keeps_the_order(tmp_path: Path) -> None:
    later, earlier = START_S + 100, 5  # 1970
    one = batch(later + 1, [sample(later, 10.0, 1)])
    two = batch(later + 2, [ClockSet(earlier * US), sample(earlier, 11.0, 2)])
    three = batch(later + 3, [ClockSet(later * US), sample(later, 12.0, 3)])
    with recorded(tmp_path, one, two, three) as reader:
        stored = reader.measurements_after(0, 9)
        assert [one.sequence for one in stored] == [1, 2, 3]
        assert [one.t_us // US for one in stored] == [later, earlier, later]
        rows = list(reader.summaries(SECONDS, 0, 2**62))
        assert [row.values["x_mm"].mean for row in rows] == [11.0, 10.0, 12.0]


def test_within_an_epoch_time_does_not_go_back(tmp_path: Path) -> None:
    late = Sample(round((START_S + 5.1) * US), at(START_S + 3))
    with recorded(tmp_path, batch(START_S + 6, [sample(START_S + 4.5), late])) as reader:
        first, second = reader.measurements_after(0, 9)
    assert first.t_us == second.t_us


def test_a_measurement_of_an_impossible_time_is_kept_at_the_time_it_was_published(tmp_path: Path) -> None:
    made = batch(START_S + 6, [Sample((START_S + 5) * US, at(START_S + 5 + 86_400))])
    with recorded(tmp_path, made) as reader:
        (stored,) = reader.measurements_after(0, 9)
    assert stored.t_us == (START_S + 5) * US


def test_roll_of_a_sensor_is_kept_while_the_beam_is_lost(tmp_path: Path) -> None:
    about = About(columns_of(QUANTITIES.with_sensor("roll_deg"), ("front", "rear")))
    roll = {"roll_deg": SensorValue(Quality.GOOD, "", 1.25, 0.01, 0, 0.0, 2**62)}
    lost = replace(at(START_S, None), from_sensors=roll)
    with recorded(tmp_path, batch(START_S + 2, [Sample((START_S + 1) * US, lost)]), about=about) as reader:
        (row,) = reader.summaries(SECONDS, 0, 2**62)
        (point,) = reader.trend(START_S * US, (START_S + 10) * US, 10).points
    assert (row.n_valid, row.values["roll_deg"].mean, row.values["roll_deg"].sigma) == (0, 1.25, 0.01)
    assert point.values == row.values


def test_the_covariance_follows_from_sigmas_and_correlations(tmp_path: Path) -> None:
    """A unit of an older program stores them from its next start on; roll has none."""
    before = store(tmp_path, About([each for each in ABOUT.columns if each.unit]))
    before.write(batch(START_S + 2, [sample(START_S)]))
    before.end(None)
    sigmas = np.array([0.004, 0.004, 0.0011, 0.0011])
    correlation = np.eye(4)
    correlation[[0, 2], [2, 0]], correlation[[1, 3], [3, 1]] = -0.8642, -0.8317
    covariance = correlation * np.outer(sigmas, sigmas)
    joint = Joint(KEYS, covariance, covariance / 4, np.ones(4))
    after = store(tmp_path, About(columns_of(QUANTITIES.with_sensor("roll_deg"), ("front", "rear"))))
    after.write(batch(START_S + 9, [Sample((START_S + 8) * US, replace(at(START_S + 8), joint=joint))]))
    after.end(None)
    with read(tmp_path) as reader:
        old, new = reader.measurements_after(0, 9)
        columns = {column.name for column in export.columns_of(reader, "measurement")}
    assert not any(key.startswith("correlation") for key in old.values)
    for (row, one), (column, other) in itertools.combinations(enumerate(KEYS), 2):
        stored = new.values[f"correlation_{one}_{other}"] * new.sigmas[one] * new.sigmas[other]
        assert stored == pytest.approx(covariance[row, column])
    assert {name for name in columns if "correlation" in name} == set(new.values) - set(old.values)
    assert len(set(new.values) - set(old.values)) == 6


def test_a_sensor_that_is_fitted_later_gets_its_columns_and_what_was_before_stays(tmp_path: Path) -> None:
    first = store(tmp_path)
    first.write(batch(START_S + 2, [sample(START_S, 10.0)]))
    first.end(None)
    with_roll = QUANTITIES.with_sensor("roll_deg")
    second = store(tmp_path, About(columns_of(with_roll, ("front", "rear", "third"))))
    second.write(batch(START_S + 9, [sample(START_S + 8, 11.0)]))
    second.end(None)
    with read(tmp_path) as reader:
        assert [row.values["x_mm"].mean for row in reader.summaries(SECONDS, 0, 2**62)] == [10.0, 11.0]
        assert "roll_deg" in reader.summarised
        assert "third.x_mm" in reader.recorded
        assert [one.values["front.x_mm"] for one in reader.measurements_after(0, 9)] == [10.012, 10.012]


class TestEvents:
    def test_come_back_newest_first_by_kind_and_time(self, tmp_path: Path) -> None:
        kinds = (EventKind.STATE, EventKind.REQUEST, EventKind.STATE)
        events = [event(n, START_S + n, kind, 1, f"text {n}") for n, kind in enumerate(kinds)]
        with recorded(tmp_path, batch(START_S + 4, [], events)) as reader:
            assert [one.text for one in reader.events(0, 2**62)][:3] == ["text 2", "text 1", "text 0"]
            assert [one.text for one in reader.events(0, 2**62, ["request"])] == ["text 1"]
            assert [one.text for one in reader.events(START_S * US, (START_S + 1) * US)] == ["text 0"]
            newest = reader.events(0, 2**62, limit=1)[0]
            assert [one.text for one in reader.events(0, 2**62, before=newest.id)][:2] == ["text 1", "text 0"]

    def test_a_quotation_mark_is_a_letter(self, tmp_path: Path) -> None:
        text = "'); DROP TABLE events; --"
        with recorded(tmp_path, batch(START_S + 4, [], [event(1, START_S, text=text)])) as reader:
            assert reader.events(0, 2**62)[0].text == text
            assert reader.events(0, 2**62, [text]) == []


def test_a_detail_that_is_no_json_costs_itself_and_nothing_else(tmp_path: Path) -> None:
    strange = replace(event(1, START_S, text="strange"), detail={"a": float("nan")})
    with recorded(tmp_path, batch(START_S + 4, [sample(START_S)], [strange, event(2, START_S)])) as reader:
        assert [(one.text, one.detail) for one in reader.events(0, 2**62)][:2] == [("t", {}), ("strange", {})]
        assert len(reader.measurements_after(0, 9)) == 1


class TestStart:
    def notices(self, folder: Path, about: About = ABOUT, ended: bool = True) -> list[tuple[str, str]]:
        writing = store(folder, about)
        written = writing.write(batch(START_S + 2, [sample(START_S + 1)]))
        writing.end(batch(START_S + 3) if ended else None)
        return [(str(notice.kind), notice.text) for notice in written.notices]

    def test_the_first_one_says_that_it_begins(self, tmp_path: Path) -> None:
        assert self.notices(tmp_path) == [("history", "new history file created")]
        assert self.notices(tmp_path) == []

    def test_one_after_another_that_was_not_ended_says_so(self, tmp_path: Path) -> None:
        self.notices(tmp_path, ended=False)
        text = "the daemon before was not ended, last heard of at 2026-11-20T08:00:01Z"
        assert self.notices(tmp_path) == [("not_ended", text)]
        assert self.notices(tmp_path) == []

    def test_what_has_changed_since_is_said(self, tmp_path: Path) -> None:
        self.notices(tmp_path, renamed(ABOUT, config='{"measuring": {"window": 20}, "a": [1, 2]}'))
        about = renamed(ABOUT, config='{"measuring": {"window": 10}, "a": [1, 2]}', version="2.0.0")
        writing = store(tmp_path, about)
        written = writing.write(batch(START_S + 9))
        writing.end(None)
        found = {notice.kind: notice.detail for notice in written.notices}
        assert found == {
            EventKind.CONFIG: {"changed": {"measuring.window": ["20", "10"]}},
            EventKind.VERSION: {"before": "1", "after": "2.0.0"},
        }


def test_what_is_written_is_on_the_disk_by_sqlites_own_word(tmp_path: Path) -> None:
    writing = store(tmp_path)
    write_seconds(writing, START_S, [10.0, None, 11.0])
    with sqlite3.connect(f"file:{tmp_path / 'history.db'}?mode=ro", uri=True) as foreign:
        assert foreign.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert foreign.execute("SELECT count(*) FROM measurements").fetchone() == (60,)
        assert foreign.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    foreign.close()
    writing.end(None)
