"""Health is of the moment at which it is read."""

import json
import math

import pytest
from support.clock import FakeClock

from altd.status.health import FIGURE_AGE_S, Health, State, duration
from altd.status.models import status_of
from tools.pages.serial_examples import unit_that_shows


def test_a_message_that_holds_a_time_counts() -> None:
    clock = FakeClock(5_000_000_000)
    health = Health(clock)
    component = health.component("camera front")
    component.set_state(State.DEGRADED, lambda now_ns: f"no frame for {(now_ns - 4_750_000_000) * 1e-9:g} s")
    assert component.message == "no frame for 0.25 s"
    clock.now_ns += 5_750_000_000
    assert component.message == "no frame for 6 s"
    components = status_of(unit_that_shows(None, health).view()).as_object()["components"]
    assert isinstance(components, dict)
    assert components["camera front"] == {"state": "degraded", "message": "no frame for 6 s", "for_s": 5.8}


def test_a_figure_that_is_too_old_is_not_known_and_keeps_its_key() -> None:
    clock = FakeClock()
    component = Health(clock).component("camera front")
    component.observe({"level": 0.62, "exposure_ms": 2.0})
    clock.now_ns += round(FIGURE_AGE_S * 1e9)
    component.observe({"level": 0.5})
    assert component.figures == {"level": 0.5, "exposure_ms": 2.0}
    clock.now_ns += 1
    assert component.figures == {"level": 0.5, "exposure_ms": None}


def test_a_figure_that_is_no_number_is_not_known_and_hides_no_other() -> None:
    health = Health(FakeClock())
    health.component("camera front").observe({"a": math.nan, "b": math.inf, "c": -math.inf, "level": 0.5})
    document = json.loads(
        json.dumps(
            status_of(unit_that_shows(None, health).view()).as_object(),
            allow_nan=False,
        )
    )
    front = document["components"]["camera front"]
    assert [front[key] for key in ("a", "b", "c", "level")] == [None, None, None, 0.5]


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (-0.1, "0.0 s"),
        (0, "0.0 s"),
        (0.25, "0.2 s"),
        (9.96, "9.9 s"),
        (10.0, "10 s"),
        (59.9, "59 s"),
        (60, "1 min"),
        (7380, "2 h 3 min"),
        (86400 * 12 + 7200, "12 d 2 h"),
    ],
)
def test_a_duration_in_words(seconds: float, words: str) -> None:
    assert duration(seconds) == words
