"""The share of time in which the unit measured, by hand-made time."""

import math
import pickle
from datetime import timedelta
from typing import Any

import pytest
from support.clock import START

from altd.status.availability import (
    MAX_GAP_S,
    NOT_RUNNING,
    NOT_WATCHED,
    Availability,
    Before,
    RunningSpan,
    Span,
)

SECOND = 10**9


class Watched:
    """An availability that is looked at each second; time begins at an odd instant of the clock."""

    def __init__(self, began_ns: int = 123_456_789_012) -> None:
        self.now_ns = began_ns
        self.availability = Availability(began_ns)
        self.availability.update(began_ns, None)

    def run(self, seconds: int, lost_to: str | None = None, step_s: int = 1) -> None:
        for _ in range(0, seconds, step_s):
            self.now_ns += step_s * SECOND
            self.availability.update(self.now_ns, lost_to)

    def span(self, name: str) -> dict[str, Any]:
        return self.availability.spans()[name].as_object()


def ran(*spans: tuple[int, str | None]) -> Watched:
    """After so many seconds each, lost to this reason."""
    watched = Watched()
    for seconds, lost_to in spans:
        watched.run(seconds, lost_to)
    return watched


def test_nothing_observed_is_no_share() -> None:
    assert Watched().span("last_hour") == {
        "share": None,
        "valid_s": 0.0,
        "observed_s": 0.0,
        "lost_s": {},
        "since": None,
    }


def test_half_valid_is_a_half_by_reason() -> None:
    watched = ran((600, None), (400, "spot_missing"), (200, "camera_silent"))
    assert watched.span("since_start") == {
        "share": 0.5,
        "valid_s": 600.0,
        "observed_s": 1200.0,
        "lost_s": {"spot_missing": 400.0, "camera_silent": 200.0},
        "since": None,
    }


def test_an_interval_is_valid_only_when_it_is_so_at_both_ends() -> None:
    watched = ran((10, None), (1, "spot_missing"), (10, None))
    assert watched.span("since_start")["lost_s"] == {"spot_missing": 2.0}


def test_the_hour_and_the_day_forget() -> None:
    watched = ran((1800, "spot_missing"), (1800, None))
    assert watched.span("last_hour")["share"] == pytest.approx(1799 / 3600, abs=1e-5)
    watched.run(1800 - 60)
    assert watched.span("last_hour")["lost_s"] == {"spot_missing": 61.0}
    watched.run(60)
    assert watched.span("last_hour")["lost_s"] == {"spot_missing": 1.0}
    watched.run(60)
    assert watched.span("last_hour")["share"] == 1.0
    assert watched.span("last_day")["share"] == pytest.approx(3659 / 5460, abs=1e-5)
    watched.run(86400)
    assert watched.span("last_day")["share"] == 1.0
    assert watched.span("since_start")["lost_s"]["spot_missing"] == pytest.approx(1800, abs=1)


def test_the_spans_hold_no_more_than_their_names_say() -> None:
    watched = ran((200_000, None))
    assert 3540 < watched.span("last_hour")["observed_s"] <= 3600
    assert 86340 < watched.span("last_day")["observed_s"] <= 86400
    assert watched.span("since_start")["observed_s"] == 200_000.0


def test_time_in_which_nobody_looked_is_lost() -> None:
    watched = ran((10, None))
    watched.now_ns += round((MAX_GAP_S + 0.1) * SECOND)
    watched.availability.update(watched.now_ns, None)
    assert watched.span("since_start")["lost_s"] == {NOT_WATCHED: 5.1}


def test_a_promise_that_is_just_missed_is_seen() -> None:
    watched = ran((97_999, None), (2001, "spot_missing"))
    assert watched.span("since_start")["share"] == 0.97999


def test_looks_of_many_readers_change_nothing() -> None:
    watched = Watched()
    for _ in range(600):
        watched.run(1)
        for _ in range(5):
            watched.availability.update(watched.now_ns, None)
    assert watched.span("since_start")["valid_s"] == 600.0


def test_memory_is_bounded() -> None:
    watched = Watched()
    reasons = ("spot_missing", "unsteady", "stale")
    watched.run(31 * 86_400, "stale", step_s=3600)
    sizes = []
    for _day in range(4):
        for minute in range(1440):
            watched.run(60, reasons[minute % 3], step_s=4)
        sizes.append(len(pickle.dumps(watched.availability)))
    assert sizes[1:] == pytest.approx([sizes[0]] * 3, rel=0.05)


def half_an_hour_before(gap_s: float = 100.0) -> Before:
    """Of half an hour on record: a daemon that ran until ``gap_s`` before the start, half of it valid."""
    return Before(1800.0, (RunningSpan(gap_s, 1800.0 - gap_s, 0.5, "spot_missing"),))


def test_the_hour_reaches_back_behind_the_start_as_far_as_is_known() -> None:
    watched = Watched()
    watched.availability.before = half_an_hour_before()
    watched.run(600)
    assert watched.span("last_hour") == {
        "share": round((600 + 850) / 2400, 5),
        "valid_s": 1450.0,
        "observed_s": 2400.0,
        "lost_s": {"spot_missing": 850.0, NOT_RUNNING: 100.0},
        "since": None,
    }
    assert watched.span("since_start")["observed_s"] == 600.0


def test_what_was_before_the_start_is_forgotten_as_time_goes_on() -> None:
    watched = Watched()
    watched.availability.before = half_an_hour_before()
    watched.run(3600 - 200)  # 200 s before the start are left: 100 s stood still, 100 s half valid
    assert watched.span("last_hour")["lost_s"] == {NOT_RUNNING: 100.0, "spot_missing": 50.0}
    watched.run(150)
    assert watched.span("last_hour")["lost_s"] == {NOT_RUNNING: 50.0}
    watched.run(50)
    assert watched.span("last_hour")["share"] == 1.0
    assert watched.span("last_day")["lost_s"] == {"spot_missing": 850.0, NOT_RUNNING: 100.0}


def test_since_when_it_is_known_is_told_in_utc() -> None:
    availability = Availability(0, lambda t_ns: START + timedelta(microseconds=t_ns / 1000))
    for second in range(601):
        availability.update(second * SECOND, None)
    since = {name: span.since for name, span in availability.spans().items()}
    spans = ("last_hour", "last_day", "last_31_days", "since_start")
    assert since == dict.fromkeys(spans, "2026-11-20T08:00:00.000Z")
    availability.before = half_an_hour_before()
    shown = {name: span.as_object() for name, span in availability.spans().items()}
    assert shown["last_hour"]["since"] == "2026-11-20T07:30:00.000Z"
    assert shown["since_start"]["since"] == "2026-11-20T08:00:00.000Z"


def test_the_31_days_hold_hours_and_what_was_before_the_start() -> None:
    watched = Watched()
    watched.availability.before = Before(40 * 86_400.0, (RunningSpan(0.0, 40 * 86_400.0, 0.5, "dusty"),))
    watched.run(86_400, "spot_missing", step_s=4)
    month = watched.span("last_31_days")
    assert month["lost_s"] == {"dusty": 15 * 86_400.0, "spot_missing": 86_400.0}
    assert month["share"] == round(15 / 31, 5)
    watched.run(32 * 86_400, step_s=3600)
    month = watched.span("last_31_days")
    assert month["lost_s"] == {NOT_WATCHED: month["observed_s"]}
    assert 31 * 86_400 - 3600 < month["observed_s"] <= 31 * 86_400


def test_no_document_has_a_number_that_json_lacks() -> None:
    with pytest.raises(ValueError, match="finite"):
        Span(share=math.nan, valid_s=0.0, observed_s=0.0, lost_s={}, since=None)
