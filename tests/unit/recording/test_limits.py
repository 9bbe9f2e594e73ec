"""``limits`` and ``turned_deg`` of a scan: what it does not show, and how the unit was mounted."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.recordings import header

from altd.config import ScanLimits
from altd.errors import BadInputError
from altd.recording.header import RecordingHeader, read_header
from altd.records import Limits


def test_limits_are_read_and_those_that_are_absent_are_known_as_not_stated() -> None:
    limits = {"stage_scale_ppm": 50, "beam_normal_mm_per_m": 0.3, "colour": "red"}
    read = RecordingHeader.model_validate(header("scan") | {"limits": limits, "turned_deg": 180})
    assert read.limits == Limits(stage_scale_ppm=50.0, beam_normal_mm_per_m=0.3)
    assert read.limits.not_stated == ("stage_mm", "stage_square_mrad", "target_distance_mm")
    assert read.turned_deg == 180.0


def test_without_the_keys_nothing_is_stated_and_the_unit_was_not_turned() -> None:
    read = RecordingHeader.model_validate(header("scan"))
    assert (read.limits, read.turned_deg) == (None, 0.0)


def test_what_altd_scan_writes_is_what_its_settings_state() -> None:
    assert ScanLimits().record is None
    stated = ScanLimits(stage_mm=0.005).record
    assert stated == Limits(stage_mm=0.005)
    written = RecordingHeader.model_validate(header("scan") | {"limits": stated}).model_dump_json()
    assert RecordingHeader.model_validate_json(written).limits == stated


@pytest.mark.parametrize(
    ("more", "place"),
    [
        ({"limits": {"stage_mm": -0.001}}, "stage_mm: -0.001 is not an uncertainty; possible: 0 to 1000"),
        ({"limits": {"stage_scale_ppm": 1e9}}, "stage_scale_ppm: 1e+09 is not an uncertainty"),
        ({"limits": {"stage_mm": "good"}}, "limits.stage_mm"),
        ({"limits": 0.1}, "limits"),
        ({"turned_deg": 90}, "turned_deg: possible: 0, 180, not 90"),
    ],
)
def test_what_is_no_limit_is_refused_by_its_key(more: dict[str, object], place: str, tmp_path: Path) -> None:
    file = tmp_path / "recording.json"
    file.write_text(json.dumps(header("scan") | more))
    with pytest.raises(BadInputError, match=place.replace("+", r"\+")):
        read_header(file)
