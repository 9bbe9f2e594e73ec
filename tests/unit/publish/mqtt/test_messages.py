"""Topics and payloads, by hand and by formula."""

import json
import math
import statistics
from dataclasses import replace

import pytest
from jsonschema import Draft202012Validator
from support.clock import FakeClock
from support.measurements import BEAM, changed, measurement

from altd.publish.mqtt.messages import Topics, birth_of, schema_of, summary_of
from altd.publish.mqtt.sparkplug import measurement_metrics
from altd.reasons import Reason
from altd.records import Measurement
from altd.records.spots import Motion
from altd.status.board import Board
from altd.status.health import Health
from altd.status.measurement_json import checked_line, with_proof
from altd.status.proof import Stamps


def test_each_payload_fits_the_schema_of_its_topic_and_no_other(
    board: Board, health: Health, clock: FakeClock
) -> None:
    board.publish(measurement())
    stamps = Stamps(board, "mqtt")
    health.calibration.summary = {"created": "2026-11-02", "simulated": False, "file": {"checksum": "1"}}
    payloads = {
        "birth": with_proof(birth_of(board, health, clock), board, stamps.next()),
        "summary": with_proof(summary_of([measurement()], board, clock), board, stamps.next()),
        "measurement": checked_line(board, measurement(), stamps.next()),
    }
    schema = schema_of(board.quantities)
    assert schema["topics"].keys() == payloads.keys() | {"state"}
    assert not Draft202012Validator(schema).is_valid({})
    for topic, line in payloads.items():
        document = json.loads(line)
        Draft202012Validator(schema).validate(document)
        for other, reference in schema["topics"].items():
            of_topic = Draft202012Validator({**reference, "$defs": schema["$defs"]})
            assert of_topic.is_valid(document) is (topic == other)


@pytest.mark.parametrize(
    ("serial", "level"),
    [
        ("ALT-0007", "ALT-0007"),
        ("A/1 +#", "A%2F1%20%2B%23"),
        ("ä\u2028", "%C3%A4%E2%80%A8"),
        ("A%2F1", "A%252F1"),
    ],
)
def test_a_serial_number_is_one_level_of_a_topic_whatever_is_in_it(serial: str, level: str) -> None:
    assert Topics.of("plant/altd", serial).state == f"plant/altd/{level}/state"


def measured(*x_mm: float) -> list[Measurement]:
    beams = [replace(BEAM, x_mm=x, sigma_x_mm=0.001 * n) for n, x in enumerate(x_mm, 1)]
    return [changed(measurement(100 + n), beam) for n, beam in enumerate(beams)]


def test_a_summary_has_mean_extremes_and_sigma_of_the_valid_measurements(
    board: Board, clock: FakeClock
) -> None:
    x_mm = (1.0, 4.0, 2.5)
    summary = summary_of([*measured(*x_mm), measurement(103, 1, Reason.STALE)], board, clock)
    assert summary["x_mm"] == {
        "mean": statistics.mean(x_mm),
        "min": 1.0,
        "max": 4.0,
        "sigma": round(math.sqrt((1 + 4 + 9) / 3) * 1e-3, 4),
        "sigma_now": None,  # its motion is not known
    }
    assert (summary["count"], summary["valid_share"], summary["status"]) == (4, 0.75, ["stale"])
    assert (summary["first"]["sequence"], summary["last"]["sequence"]) == (100, 103)
    assert [key for key in summary if isinstance(summary[key], dict)][2:] == [
        "x_mm",
        "y_mm",
        "yaw_deg",
        "pitch_deg",
    ]


def test_sigma_now_is_that_of_the_last_measurement_at_sending(board: Board, clock: FakeClock) -> None:
    """2 mm/s beside a sigma of 0.004 mm, 0.5 s after the middle of the exposures."""
    motion = Motion(2.0, 0.01, 0.0, 0.0, 0.475, 0.083, probable_rate=2.0, acceleration=0.0)
    moving = replace(measurement(), motions={"x_mm": motion}, t_ns=clock.now_ns)
    board.publish(moving)
    clock.now_ns += 500_000_000
    sigma = math.hypot(moving.sigma("x_mm") or 0.0, 1.0)
    assert summary_of([moving], board, clock)["x_mm"]["sigma_now"] == pytest.approx(sigma, abs=1e-3)
    metrics = {each.name: each.value for each in measurement_metrics(moving, board, clock)}
    assert metrics["sigma_now/x_mm"] == pytest.approx(sigma, abs=1e-3)
    assert metrics["sigma_now/y_mm"] is None


NOTHING = dict.fromkeys(("mean", "min", "max", "sigma", "sigma_now"))


def test_a_summary_without_a_valid_measurement_has_no_number(board: Board, clock: FakeClock) -> None:
    board.publish(measurement())  # that of before is still on the board
    reasons = (Reason.STALE, Reason.SIMULATED)
    summary = summary_of([measurement(161, 1, *reasons)] * 2, board, clock)
    assert summary["x_mm"] == summary["pitch_deg"] == NOTHING
    assert (summary["valid_share"], summary["status"]) == (0.0, ["stale", "simulated"])


def test_a_second_without_a_measurement_has_no_number_of_an_earlier_one(
    board: Board, clock: FakeClock
) -> None:
    assert summary_of([], board, clock)["status"] == ["warming_up"]
    board.publish(measurement(160, clock.now_ns))
    clock.now_ns += 2_000_000_000
    summary = summary_of([], board, clock)
    assert summary["x_mm"] == NOTHING
    assert (summary["count"], summary["valid_share"], summary["first"]) == (0, None, None)
    assert summary["status"] == ["stale"]


def test_a_birth_names_unit_calibration_and_quantities(
    board: Board, health: Health, clock: FakeClock
) -> None:
    health.calibration.summary = {
        "created": "2026-11-02",
        "simulated": True,
        "file": {"checksum": "sha256:1"},
    }
    birth = birth_of(board, health, clock)
    assert (birth["serial"], birth["version"]) == ("ALT-0007", "0.1.0")
    assert birth["calibration"] == {"created": "2026-11-02", "checksum": "sha256:1", "simulated": True}
    assert birth["quantities"]["yaw_deg"]["unit"] == "°"
