"""What the calibration says of itself: the file's own numbers, and a sigma that is known by formulas."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.evidence import DISTANCE_MM, calibration, target
from support.played_unit import PlayedUnit
from support.recordings import PX_PER_MM

from altd.app.calibration_summary import MAX_TEXT_CHARACTERS, summary_of
from altd.calibration.file import load_calibration, save_calibration
from altd.calibration.report.prediction import predict
from altd.publish.http.calibration_models import CalibrationSummary
from altd.records import CameraIdentity, Origin

BOTH = ("front", "rear")
REPORT = {"report": {"available": False, "why": "none"}}


def test_it_says_what_stands_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "unit-7.json"
    save_calibration(calibration(), path)
    written = json.loads(path.read_text())
    told = summary_of(load_calibration(path), BOTH, 20, path.name)
    assert told["unit"] == written["unit"]["serial"]
    assert told["created"] == written["created"] == "2026-11-20T08:15:30.000Z"
    assert told["recording"] == written["recording"]
    assert (told["file"]["name"], told["file"]["checksum"]) == ("unit-7.json", written["checksum"])
    for shown, of in zip(told["targets"], written["targets"], strict=True):
        assert shown["residuals"] == pytest.approx(of["residuals"], rel=1e-3)
        assert shown["repeatability_px"] == pytest.approx(of["repeatability_px"], rel=1e-3)
        assert shown["cross_check"]["bound_px"] == of["cross_check"]["bound_px"]
        assert (shown["leds"], shown["width"], shown["height"]) == (len(of["leds_px"]), 752, 480)
        assert (shown["flat"], shown["fingerprint"], shown["simulated"]) == (None, None, False)
        xs, ys = zip(*of["map"]["hull_mm"], strict=True)
        assert shown["x_mm"] == [min(xs), max(xs)]
        assert shown["y_mm"] == [min(ys), max(ys)]
    CalibrationSummary.model_validate({**told, **REPORT})


def test_the_expected_sigma_of_straight_maps_is_the_closed_form() -> None:
    """0.03 px of pattern, 0.01 px of a common shift, 0.02 px of scatter of one exposure: all independent."""
    told = summary_of(calibration(), BOTH, 16, "cal.json")
    one_mm = math.sqrt(0.03**2 + 0.01**2 + 0.02**2 / 16) / PX_PER_MM
    angle_deg = math.degrees(math.sqrt(2) * one_mm / DISTANCE_MM)
    assert told["exposures"] == 16
    expected = {"x_mm": one_mm, "y_mm": one_mm, "yaw_deg": angle_deg, "pitch_deg": angle_deg}
    assert told["expected_sigma"] == pytest.approx(expected, rel=1e-3)


def test_the_expected_sigma_is_about_that_of_the_report(played_unit: PlayedUnit) -> None:
    loaded = load_calibration(played_unit.calibration)
    told, report = summary_of(loaded, BOTH, 20, "cal.json"), predict(loaded)
    for key, sigma in told["expected_sigma"].items():
        assert sigma == pytest.approx(report.rms(key), rel=0.1), key


def test_targets_without_a_common_area_have_no_expected_sigma() -> None:
    rear = target("rear")
    aside = replace(rear.map, hull_mm=rear.map.hull_mm + np.array([0.0, 200.0]))
    told = summary_of(calibration(target("front"), replace(rear, map=aside)), BOTH, 20, "cal.json")
    assert told["expected_sigma"] == {}


def test_what_was_simulated_says_so_and_only_the_units_targets_are_told() -> None:
    made = calibration(target("front"), replace(target("rear"), origin=Origin.SIMULATED))
    told = summary_of(made, ("front",), 20, "cal.json")
    assert told["simulated"] is True
    assert [(each["name"], each["simulated"]) for each in told["targets"]] == [("front", False)]


def test_texts_of_a_foreign_file_stay_short_and_are_json() -> None:
    evil = "<img src=x onerror=alert(1)>\ud800\x1b[2J\u202e" + "A" * 5_000_000
    camera = CameraIdentity(evil, evil, evil)
    made = replace(
        calibration(replace(target("front"), camera=camera)),
        unit_serial=evil,
        recording_note=evil,
        recording_sha256=evil,
    )
    told = summary_of(made, ("front",), 20, evil)
    text = json.dumps(told, ensure_ascii=False, allow_nan=False).encode("utf-8")
    assert len(text) < 20 * MAX_TEXT_CHARACTERS
    assert told["recording"]["note"].startswith("<img src=x onerror=alert(1)>\\ud800\\x1b[2J\\u202eAAA")


def test_a_number_that_is_none_is_null() -> None:
    broken = replace(target("front"), residual_mean_mm=math.nan, leave_one_out_px=math.inf)
    (told,) = summary_of(calibration(broken), ("front",), 20, "cal.json")["targets"]
    assert (told["residuals"]["mean_mm"], told["left_out_px"]) == (None, None)
