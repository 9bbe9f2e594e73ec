"""A measurement, with an inclinometer and of a round, on the interfaces: what is true now; ``targets``."""

import json
import math
import re
from dataclasses import replace

import pytest
from pydantic import ValidationError
from support.clock import FakeClock
from support.measurements import BEAM, beam_of, measurement, measurement_of_row

from altd.files.documents import line_of
from altd.history.records import StoredMeasurement
from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.http.answers import page_of
from altd.publish.http.metrics import Metrics
from altd.publish.mqtt.home_assistant import discovery_of
from altd.publish.mqtt.messages import Topics, summary_of
from altd.publish.serial.words import measurement_text
from altd.reasons import Reason
from altd.records import Fault, Finding, Measurement
from altd.records.sensors import Quality, SensorValue
from altd.status.board import Board
from altd.status.health import Health
from altd.status.measurement_json import (
    as_object,
    as_object_now,
    checked_line,
    measurement_model,
    targets_object,
)
from altd.status.proof import Stamps
from altd.status.unit import PublishedUnit
from tools.pages.example import AGE_S, MEASURED

KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")


def test_the_example_of_the_pages_has_each_number_of_a_beam() -> None:
    measured = [each for each in QUANTITIES.of_unit if not each.is_optional]
    assert MEASURED.values.keys() == {each.key for each in measured}
    assert MEASURED.motions.keys() == {each.key for each in measured if each.has_sigma}


def test_what_replay_writes_stays_as_it_is_and_nothing_of_now_is_in_it() -> None:
    assert as_object_now(MEASURED, AGE_S).items() >= as_object(MEASURED).items()
    assert "now" not in line_of(as_object(MEASURED))
    assert "rates" not in line_of(as_object(MEASURED))


def test_sigma_now_grows_with_age() -> None:
    sigmas = [as_object_now(MEASURED, age_s)["sigma_now"]["x_mm"] for age_s in (0.0, 0.5, 1.0, 10.0)]
    assert sigmas == sorted(sigmas)
    assert sigmas[0] == pytest.approx(math.hypot(0.004, 0.0102), abs=1e-4)
    # sigma, vibration and the way of 10 s at 0.0512 mm/s; half of 0.004 mm/s² over 10 s
    assert sigmas[-1] == pytest.approx(math.hypot(0.004, 0.0102, 0.512, 0.2), abs=1e-3)


def test_the_covariance_has_the_sigmas_on_its_diagonal_and_is_null_where_a_number_is() -> None:
    slopes = [1000 * math.tan(math.radians(MEASURED.values[key].value)) for key in KEYS[2:]]
    per_deg = [1.0, 1.0, *(1000 * math.radians(1) * (1 + (slope / 1000) ** 2) for slope in slopes)]
    document = as_object_now(MEASURED, AGE_S)
    for name, of in (("covariance", "sigma"), ("covariance_now", "sigma_now")):
        diagonal = [math.sqrt(document[name][place][place]) for place in range(4)]
        assert diagonal == pytest.approx(
            [document[of][key] * per_deg[at] for at, key in enumerate(KEYS)], rel=0.01
        )
    nothing = [[None] * 4] * 4
    invalid = as_object_now(MEASURED.without_numbers(()), AGE_S)
    assert (invalid["covariance"], invalid["covariance_now"]) == (nothing, nothing)
    assert as_object_now(replace(MEASURED, motions={}), AGE_S)["covariance_now"] == nothing
    roll = SensorValue(Quality.GOOD, value=60.0, sigma=0.1, expires_ns=10**12)
    with_roll = replace(MEASURED, quantities=QUANTITIES.with_sensor("roll_deg")).with_sensors(
        {"roll_deg": roll}
    )
    rows = as_object(with_roll)["covariance"]
    assert [row[:4] for row in rows[:4]] == document["covariance"]
    assert rows[4] == [0, 0, 0, 0, pytest.approx((1000 * math.radians(0.1) * 4) ** 2, rel=1e-5)]
    assert as_object(with_roll.without_numbers(()))["covariance"][4] == [None] * 4 + rows[4][4:]


def test_rates_are_per_second_with_their_sigma() -> None:
    rates = as_object_now(MEASURED, AGE_S)["rates"]
    assert rates["y_mm_per_s"] == -0.0214
    assert rates["sigma"]["y_mm_per_s"] == 0.0031
    assert [*rates] == [*(f"{key}_per_s" for key in KEYS), "sigma"]


@pytest.mark.parametrize(
    ("measurement", "age_s"),
    [
        (MEASURED.without_numbers(()), AGE_S),
        (replace(MEASURED, motions={}), AGE_S),
        (MEASURED, None),
    ],
)
def test_what_is_not_known_is_null(measurement: Measurement, age_s: float | None) -> None:
    document = json.loads(line_of(as_object_now(measurement, age_s)))
    assert document["sigma_now"] == dict.fromkeys(KEYS)
    if age_s is not None:
        rates = dict.fromkeys(f"{key}_per_s" for key in KEYS)
        assert document["rates"] == {**rates, "sigma": rates}


def test_frames_ahead_of_the_clock_are_not_better_than_those_of_now() -> None:
    assert as_object_now(MEASURED, -5.0)["sigma_now"] == as_object_now(MEASURED, 0.0)["sigma_now"]


NAMES = ("t1", "t1_b", "t3")
"""The second begins with the name of the first."""
STATUS = (Fault(Reason.BEAM_ANGLE_UNKNOWN), Fault(Reason.STUCK_CLEAR, "t1_b"), Fault(Reason.ALARM_RATE, "t3"))
ROUND = measurement_of_row(NAMES, {"t1": (0.0, 0.0), "t3": (0.32, -0.24)}, lost=("t1_b",), status=STATUS)


def test_each_target_has_its_own_status_values_and_sigmas() -> None:
    document = as_object(ROUND)
    assert document["valid"]
    assert document["status"] == ["beam_angle_unknown", "t1_b_stuck_clear", "t3_alarm_rate"]
    targets = document["targets"]
    assert [of["status"] for of in targets.values()] == [[], ["stuck_clear"], ["alarm_rate"]]
    assert [of["valid"] for of in targets.values()] == [True, False, True]
    t3 = targets["t3"]
    assert [t3[key] for key in ("x_mm", "y_mm", "dx_mm", "dy_mm", "significance")] == [
        1.25, -2.5, 0.32, -0.24, 7.5,
    ]  # fmt: skip
    assert t3["sigma"] == {
        "x_mm": 0.01, "y_mm": 0.01, "dx_mm_per_day": None, "dy_mm_per_day": None, "dx_mm": 0.004,
        "dy_mm": 0.004,
    }  # fmt: skip
    others = targets["t1_b"].keys() - {"valid", "status", "sigma"}
    assert {targets["t1_b"][key] for key in others} == {None}
    assert (document["t3_dx_mm"], document["sigma"]["t3_dx_mm"]) == (0.32, 0.004)
    assert (document["measured"], document["t1_b_dx_mm"]) == (2.0, None)


def test_what_is_sent_fits_its_model_and_a_key_too_many_does_not() -> None:
    clock = FakeClock(now_ns=8 * 10**9)
    board = Board(clock, 10.0, ROUND.quantities)
    published = board.publish(ROUND)
    document = json.loads(checked_line(board, published, Stamps(board, "http").next()))
    model = measurement_model(ROUND.quantities)
    model.model_validate(document)
    document["targets"]["t3"]["dz_mm"] = 1.0
    with pytest.raises(ValidationError, match=r"targets\.t3\.dz_mm"):
        model.model_validate(document)


def test_a_row_of_the_history_gives_the_same_targets() -> None:
    known = dict(ROUND.values)
    targets = ROUND.targets.items()
    known |= {f"{name}.{key}": value for name, of in targets for key, value in (of or {}).items()}
    row = StoredMeasurement(
        1, 1, 0, 139, 7, 20, True, tuple(map(str, STATUS)),
        {key: value.value for key, value in known.items()},
        {key: value.sigma for key, value in known.items() if value.sigma is not None},
        {},
    )  # fmt: skip
    targets = targets_object(ROUND.quantities, NAMES, row.known, row.status)["targets"]
    assert targets == as_object(ROUND)["targets"]


def test_metrics_home_assistant_and_summary_have_each_place() -> None:
    clock = FakeClock(now_ns=8 * 10**9)
    board = Board(clock, 10.0, ROUND.quantities)
    board.publish(ROUND)
    published = PublishedUnit(board, Health(clock))
    metrics = Metrics(published).text().decode()
    assert "\naltd_t3_dx_mm 0.32\n" in metrics
    assert '\naltd_target_significance{target="t3"} 7.5\n' in metrics
    assert 'altd_target_x_mm{target="t1_b"}' not in metrics
    topics = Topics.of("altd", "ROW-1")
    sensors = discovery_of(ROUND.quantities, topics, "altd_1", "ROW-1", "0.1.0")["cmps"]
    assert "unit_of_measurement" not in sensors["measured"]
    assert sensors["t3_dy_mm"]["unit_of_measurement"] == "mm"
    summary = summary_of([ROUND], published.view())
    assert (summary["t3_dx_mm"]["mean"], summary["t1_b_dx_mm"]["mean"]) == (0.32, None)


FITTED = QUANTITIES.with_sensor("roll_deg")
GOOD = SensorValue(Quality.GOOD, value=-1.25, sigma=0.08, t_ns=79 * 10**8, age_s=0.1, expires_ns=87 * 10**8)
FROZEN = SensorValue(Quality.FROZEN, "the same words for 0.8 s")
WARNS = [Reason.ROLL_MISSING]


def with_roll(said: SensorValue, *reasons: Reason) -> Measurement:
    plain = replace(measurement(160, 8_000_000_000, *reasons), quantities=FITTED)
    return plain.with_sensors({"roll_deg": said})


def reasons(shown: Measurement | None) -> list[Reason]:
    return [fault.reason for fault in shown.status]


def test_a_sensor_adds_its_value_and_leaves_the_beam_alone() -> None:
    both = with_roll(GOOD)
    assert (both.number("roll_deg"), both.sigma("roll_deg")) == (-1.25, 0.08)
    assert beam_of(both) == BEAM
    assert both.status == ()


def test_a_sensor_that_says_nothing_is_warned_of_and_the_beam_is_valid() -> None:
    both = with_roll(FROZEN)
    assert both.number("roll_deg") is both.sigma("roll_deg") is None
    assert both.valid
    assert beam_of(both) == BEAM
    assert [(str(fault), fault.detail) for fault in both.status] == [("roll_missing", FROZEN.detail)]


def test_a_sensor_that_speaks_again_takes_its_warning_back() -> None:
    again = with_roll(FROZEN, Reason.PLAYBACK).with_sensors({"roll_deg": GOOD})
    assert reasons(again) == [Reason.PLAYBACK]


def test_roll_stays_when_the_beam_is_blocked() -> None:
    blocked = with_roll(GOOD, Reason.SPOT_MISSING)
    assert not blocked.valid
    assert blocked.number("roll_deg") == -1.25
    assert blocked.number("x_mm") is None
    assert blocked.without_numbers(blocked.status).number("roll_deg") == -1.25


class TestBoard:
    def test_drops_roll_by_its_own_age_and_keeps_the_beam(self) -> None:
        clock = FakeClock(8_000_000_000)
        board = Board(clock, 1.0, FITTED, sense=lambda _: Finding(from_sensors={"roll_deg": GOOD}))
        board.publish(replace(measurement(), quantities=FITTED))
        clock.now_ns = GOOD.expires_ns
        assert board.read().number("roll_deg") == -1.25  # type: ignore[union-attr]
        clock.now_ns += 1
        old = board.read()
        assert old.number("roll_deg") is None
        assert old.from_sensors["roll_deg"].quality is Quality.OLD
        assert reasons(old) == WARNS
        assert beam_of(old) == BEAM
        assert board.read() is old  # interfaces recognise it

    def test_a_stale_measurement_drops_it_too(self) -> None:
        clock = FakeClock(8_000_000_000)
        late = replace(GOOD, expires_ns=9_500_000_000)
        board = Board(clock, 1.0, FITTED, sense=lambda _: Finding(from_sensors={"roll_deg": late}))
        board.publish(replace(measurement(), quantities=FITTED))
        clock.now_ns = 9_400_000_000
        assert reasons(board.read()) == [Reason.STALE]
        assert board.read().number("roll_deg") == -1.25  # type: ignore[union-attr]
        clock.now_ns = 9_600_000_000
        assert reasons(board.read()) == [*WARNS, Reason.STALE]
        assert board.read().number("roll_deg") is None  # type: ignore[union-attr]


class TestFaces:
    def test_json_has_value_sigma_age_and_quality(self) -> None:
        document = as_object(with_roll(GOOD))
        assert document["roll_deg"] == -1.25
        assert document["sigma"]["roll_deg"] == 0.08
        assert document["sensors"] == {"roll_deg": {"quality": "good", "age_s": 0.1}}

    def test_json_says_why_there_is_none(self) -> None:
        document = json.loads(line_of(as_object(with_roll(FROZEN))))
        assert document["roll_deg"] is document["sigma"]["roll_deg"] is None
        assert document["sensors"] == {"roll_deg": {"quality": "frozen", "age_s": None}}
        assert document["status"] == ["roll_missing"]
        assert document["valid"] is True

    def test_json_without_an_inclinometer_is_what_it_was(self) -> None:
        document = as_object(measurement())
        assert "sensors" not in document
        assert list(document["sigma"]) == ["x_mm", "y_mm", "yaw_deg", "pitch_deg"]

    def test_the_console_shows_it_whether_or_not_the_beam_is_seen(self) -> None:
        assert "  roll      -1.2500 deg +/- 0.0800" in measurement_text(with_roll(GOOD)).splitlines()
        blocked = measurement_text(with_roll(GOOD, Reason.SPOT_MISSING)).splitlines()
        assert blocked[1:3] == ["  NOT VALID", "  roll      -1.2500 deg +/- 0.0800"]
        assert "  roll      not available" in measurement_text(with_roll(FROZEN)).splitlines()
        assert "the same words for 0.8 s" in measurement_text(with_roll(FROZEN))

    def test_the_page_has_a_row_for_it_where_an_inclinometer_is_fitted(self) -> None:
        shown = '"key": "roll_deg".*"is_shown": true'
        assert re.search(shown, page_of(FITTED))
        assert not re.search(shown, page_of(QUANTITIES))
