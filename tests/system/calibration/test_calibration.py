"""Whole scans through the calibration: what is left out of them, and what is doubted."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.played_unit import PlayedUnit
from support.recordings import Shot, place_px, write

from altd.calibration.calibrating import calibrate
from altd.calibration.from_scans import calibrate_scans
from altd.calibration.target_frames import target_frames
from altd.errors import BadInputError
from altd.recording.reader import open_recording
from altd.vision.flat import Flat


@pytest.fixture
def scan(played_unit: PlayedUnit) -> Path:
    return played_unit.folder / "scan"


def test_the_evidence_is_what_the_calibration_was_made_from(tmp_path: Path) -> None:
    """One node dark for the front, one bumped, the others exposed twice, but for one."""
    places = [(25.0 * (i - 2.5), 25.0 * (j - 2)) for j in range(5) for i in range(6)]
    shots: list[Shot] = []
    for number, place in enumerate(places):
        reached = (place[0] + 2.0, place[1]) if number == 16 else place
        shots += [(None if number == 9 else reached, reached, place)] * (1 if number == 20 else 2)
    result = calibrate([open_recording(write(tmp_path / "rec", "scan", shots))])
    assert [evidence.name for evidence in result.evidence] == ["front", "rear"]
    front, rear = result.evidence
    assert [(place, why.split(" (")[0].split(" lies")[0]) for place, why in front.excluded] == [
        (places[9], "spot_missing in front0018.png"),
        (places[16], "its spot"),
    ]
    assert [place for place, _ in rear.excluded] == [places[16]]
    used = [place for number, place in enumerate(places) if number not in (9, 16)]
    assert front.nodes_mm == pytest.approx(np.array(used))
    assert front.nodes_px == pytest.approx(np.array([place_px("front", *place) for place in used]), abs=0.1)
    assert front.exposures == (2,) * 18 + (1,) + (2,) * 9
    assert np.isnan(front.scatter_px[18]).all()
    assert 0.001 < np.nanmean(front.scatter_px) < 0.05
    target = result.calibration.targets[0]
    assert front.residuals_px == pytest.approx(front.nodes_px - target.map.to_px(front.nodes_mm), abs=1e-3)
    assert np.sqrt(np.mean(front.leave_one_out_residuals_px**2)) == pytest.approx(target.leave_one_out_px)
    assert {candidate.model for candidate in front.candidates} >= {"tensor", "lens", "fisheye"}
    assert result.doubts == ()


def test_maps_that_lie_too_far_apart_are_doubted(scan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("altd.measuring.cross_check._LIMIT_SIGMAS", 0.1)
    front, rear = calibrate([open_recording(scan)]).doubts
    assert re.match(r"front: the \S+ and the \S+ map lie up to 0\.0\d px apart; ", front)
    assert rear.endswith(" px a measurement will be implausible")


def test_a_flat_of_another_target_is_doubted(scan: Path) -> None:
    strange = Flat.of(np.random.default_rng(1).uniform(0.7, 1, (480, 752)), "recording")
    result = calibrate_scans(target_frames([open_recording(scan)]), {"front": strange}, lambda *_: None)
    assert result.remarks[:2] == ("front: localised through its recorded flat", "rear: plain, no print")
    of_flat, of_view = result.doubts
    assert re.match(r"front: the flat does not match the spots \(correlation -?0\.0\d of 1\): ", of_flat)
    assert of_view.startswith("front: the flat does not show the spots' ground")


def test_a_dark_node_is_reported_and_survived(scan: Path, tmp_path: Path) -> None:
    places = [row.position_mm for row in open_recording(scan).rows if row.camera == "front"]
    shots = [(None if n == 7 else place, place, place) for n, place in enumerate(places)]
    result = calibrate([open_recording(write(tmp_path / "rec", "scan", shots))])
    why = "spot_missing in front0007.png (nothing is brighter than the background)"
    assert result.refused == (f"front node x -37.5 y -25 mm: {why}",)
    target = result.calibration.target("front")
    assert target is not None
    point = target.point(*place_px("front", -37.5, -25.0))
    assert point is not None
    assert (point.x_mm, point.y_mm) == pytest.approx((-37.5, -25.0), abs=0.03)


def test_too_many_dark_nodes_are_refused(scan: Path, tmp_path: Path) -> None:
    places = [row.position_mm for row in open_recording(scan).rows if row.camera == "front"]
    shots = [(place, None if n % 3 else place, place) for n, place in enumerate(places)]
    with pytest.raises(BadInputError, match="rear: 20 of 30 nodes have no spot: spot_missing"):
        calibrate([open_recording(write(tmp_path / "rec", "scan", shots))])


@pytest.mark.parametrize("bumped", [0, 8, 29])
def test_a_node_at_which_the_stage_was_bumped_is_reported_and_survived(
    bumped: int, scan: Path, tmp_path: Path
) -> None:
    places = [row.position_mm for row in open_recording(scan).rows if row.camera == "front"]
    meant = places[bumped]
    assert meant is not None
    reached = meant[0] * 0.96, meant[1] * 0.96  # towards the middle, so that it stays in the picture
    shots = [(reached, reached, p) if n == bumped else (p, p, p) for n, p in enumerate(places)]
    result = calibrate([open_recording(write(tmp_path / "rec", "scan", shots))])
    node = f"node x {meant[0]:g} y {meant[1]:g} mm: its spot lies "
    assert [line.split(node)[0] for line in result.refused] == ["front ", "rear "]
    off_px = float(result.refused[0].split(node)[1].split()[0])
    assert off_px == pytest.approx(np.hypot(*(np.subtract(meant, reached) * 4.0)), rel=0.15)
    target = result.calibration.target("rear")
    assert target is not None
    point = target.point(*place_px("rear", meant[0] * 0.7, meant[1] * 0.7))
    assert point is not None
    assert (point.x_mm, point.y_mm) == pytest.approx((meant[0] * 0.7, meant[1] * 0.7), abs=0.05)


def test_an_undecodable_frame_ends_the_calibration_with_its_row(scan: Path, tmp_path: Path) -> None:
    copy = tmp_path / "rec"
    copy.mkdir()
    for path in scan.iterdir():
        (copy / path.name).write_bytes(path.read_bytes())
    damaged = copy / "rear0003.png"
    damaged.write_bytes(damaged.read_bytes()[:300])
    with pytest.raises(BadInputError, match=r"row 9: rear0003\.png cannot be decoded"):
        calibrate([open_recording(copy)])
    assert cv2.imread(str(copy / "rear0002.png"), cv2.IMREAD_UNCHANGED) is not None
