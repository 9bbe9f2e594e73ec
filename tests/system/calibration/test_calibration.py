"""Whole scans through the calibration: what is left out, doubted, cut off, and claimed beyond the nodes."""

import json
import pickle
import re
import shutil
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.cross_checked import difference_px, fitted_unit
from support.frames import HEIGHT, WIDTH
from support.lenses import TABLE_3_2, LensKind
from support.played_unit import PlayedUnit
from support.recordings import Shot, grid, place_px, write, write_scan

from altd.calibration.calibrating import calibrate
from altd.calibration.file import load_calibration, save_calibration
from altd.calibration.fitting import fit_nodes, outer_rows
from altd.calibration.from_scans import calibrate_scans
from altd.calibration.result import CalibrationResult
from altd.calibration.target_frames import target_frames
from altd.errors import BadInputError
from altd.mapping.inverse import InverseMap
from altd.mapping.nodes import Nodes
from altd.recording.reader import open_recording
from altd.records import CameraIdentity
from altd.vision.flat import Flat
from hw_sim.lens import HEIGHT_PX, WIDTH_PX


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
    strange = Flat.from_response(np.random.default_rng(1).uniform(0.7, 1, (480, 752)), "recording")
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


@pytest.mark.parametrize("bumped", [8, 29])
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
    copy = shutil.copytree(scan, tmp_path / "rec")
    damaged = copy / "rear0003.png"
    damaged.write_bytes(damaged.read_bytes()[:300])
    with pytest.raises(BadInputError, match=r"row 9: rear0003\.png cannot be decoded"):
        calibrate([open_recording(copy)])
    assert cv2.imread(str(copy / "rear0002.png"), cv2.IMREAD_UNCHANGED) is not None


COLUMNS_MM = -70.0, -42.0, -14.0, 14.0, 42.0, 70.0
ROWS_MM = -55.0, -27.5, 0.0, 27.5, 55.0
CUT_ROWS_MM = -60.0, -30.0, 0.0, 30.0, 60.0
"""The spots of the outer rows have 40 px and are 9 px from the border of the picture, which cuts them."""

Place = tuple[float, float]


def calibrated(
    path: Path, dark_in_front: Iterable[Place] = (), rows_mm: Iterable[float] = ROWS_MM
) -> CalibrationResult:
    """The calibration of a scan in which some nodes have no spot on the front target."""
    dark = set(dark_in_front)
    shots: list[Shot] = [
        (None if (x, y) in dark else (x, y), (x, y), (x, y)) for y in rows_mm for x in COLUMNS_MM
    ]
    return calibrate([open_recording(write(path, "scan", shots))])


def test_nodes_that_the_border_cuts_are_used_and_named_with_their_weight(tmp_path: Path) -> None:
    result = calibrated(tmp_path / "scan", rows_mm=CUT_ROWS_MM)
    assert result.refused == ()
    named = [line for line in result.remarks if " counts by 1/" in line]
    assert named
    assert all(" y -60 mm" in line or " y 60 mm" in line for line in named)
    for seen in result.evidence:
        inner = np.abs(seen.nodes_mm[:, 1]) < 50
        assert np.all(seen.relative_sigma[inner] == 1.0)
        assert np.median(seen.relative_sigma[~inner]) > 1.0


def test_a_missing_row_is_named_and_does_not_refuse_the_scan(tmp_path: Path) -> None:
    top = [(x, ROWS_MM[-1]) for x in COLUMNS_MM]
    result = calibrated(tmp_path / "scan", [*top, (14.0, 0.0)])  # seven of thirty
    assert len(result.refused) == 7
    assert all(line.startswith("front node x ") and "spot_missing" in line for line in result.refused)
    # with four rows left none can be left out to see what is known beyond them
    (doubt,) = [line for line in result.doubts if "outer row" in line]
    assert doubt == (
        "front: no node of the outer row at y 55 mm can be used: the measurable area ends at y 27.5 mm"
    )
    front = result.calibration.target("front")
    assert front is not None
    for y_mm, known in ((20.0, True), (27.0, True), (30.0, False)):
        point = front.point(*place_px("front", -28.0, y_mm))
        assert (point is not None) is known
        if point is not None:
            assert (point.x_mm, point.y_mm) == pytest.approx((-28.0, y_mm), abs=0.05)


def test_two_missing_rows_of_five_refuse_it(tmp_path: Path) -> None:
    outer = [(x, y) for x in COLUMNS_MM for y in (ROWS_MM[0], ROWS_MM[-1])]
    with pytest.raises(BadInputError, match="front: 12 of 30 nodes have no spot"):
        calibrated(tmp_path / "scan", outer)


def test_too_few_nodes_are_named_with_what_a_map_needs(tmp_path: Path) -> None:
    write(tmp_path / "scan", "scan", [(node, node, node) for node in grid(2, 2)])
    with pytest.raises(BadInputError, match=r"4 nodes do not form a usable grid: .* at least 4 × 4"):
        calibrate([open_recording(tmp_path / "scan")])


def test_the_outer_rows_of_a_unit_that_this_project_did_not_make_are_where_they_are_predicted(
    unit_a: Path,
) -> None:
    """A whole pitch of 25 mm outside of the other nodes: twice what a map is ever asked for."""
    made = pickle.loads((unit_a / "result.pickle").read_bytes())
    normalised = []
    for seen in made.evidence:
        for row in outer_rows(seen.nodes_mm):
            others = np.delete(np.arange(len(seen.nodes_mm)), row.rows)
            places, px = seen.nodes_mm[others], seen.nodes_px[others]
            alone = fit_nodes(Nodes.ordinary(places, px), (WIDTH_PX, HEIGHT_PX), 0).fit.map
            mm, _, covariance = InverseMap(replace(alone, margin_mm=26.0)).to_mm(seen.nodes_px[row.rows])
            sigma_mm = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
            normalised.append((mm - seen.nodes_mm[row.rows]) / sigma_mm)
    assert 0.8 < np.sqrt(np.mean(np.square(np.concatenate(normalised)))) < 1.25


def test_the_file_carries_the_identities_of_the_scans_cameras(tmp_path: Path) -> None:
    scan = write_scan(tmp_path / "rec")
    header = json.loads((scan / "recording.json").read_text())
    front = {**header["cameras"]["front"], "serial": "F-7", "model": "mini", "driver": "aravis"}
    header["cameras"] = {**header["cameras"], "front": front}
    (scan / "recording.json").write_text(json.dumps(header))
    save_calibration(calibrate([open_recording(scan)]).calibration, tmp_path / "cal.json")
    known, unknown = load_calibration(tmp_path / "cal.json").targets
    assert known.camera == CameraIdentity("F-7", "mini", "aravis")
    assert unknown.camera == CameraIdentity()


@pytest.mark.parametrize("kind", TABLE_3_2, ids=str)
def test_on_good_units_the_maps_agree_everywhere(kind: LensKind) -> None:
    for seed in range(6):
        fitted, rng = fitted_unit(kind, seed)
        points = rng.uniform((-62.5, -50), (62.5, 50), (300, 2))
        apart = difference_px(fitted, fitted.fit.map, points)
        assert apart.max() < 0.7 * fitted.cross_check.limit_px
        assert apart.max() <= fitted.cross_check.max_difference_px * 1.1
        assert fitted.cross_check.max_difference_px <= apart.max() * 2


Light = Callable[[tuple[float, float], np.ndarray, np.ndarray], np.ndarray]
"""Light of a beam at a place (mm), by the distance from its axis (px); the brightest is about 1."""


def picture_of(beam: Light) -> Any:
    """Pictures of beams, with the noise of a camera."""
    v_px, u_px = np.mgrid[:HEIGHT, :WIDTH]

    def picture(target: str, x_mm: float, y_mm: float, rng: np.random.Generator) -> np.ndarray:
        u, v = place_px(target, x_mm, y_mm)
        counts = 8 + 150 * beam((x_mm, y_mm), u_px - u, v_px - v)
        noisy = rng.normal(counts, np.sqrt(1 + 0.02 * counts))
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    return picture


def test_a_beam_that_the_calibrated_unit_refuses_is_refused(tmp_path: Path) -> None:
    """A donut (Laguerre-Gauss mode 0, 1) of 24 px: its ring is 17.6 mm wide."""

    def donut(_: object, u_px: np.ndarray, v_px: np.ndarray) -> np.ndarray:
        q = 2 * (u_px**2 + v_px**2) / 24**2
        light: np.ndarray = np.e * q * np.exp(-q)
        return light

    scan = open_recording(write_scan(tmp_path / "scan", picture=picture_of(donut)))
    with pytest.raises(
        BadInputError, match=r"spots of 30 of 30 nodes: wrong_size: the spot is 17\.6 mm wide"
    ):
        calibrate([scan])


def test_a_node_that_the_calibrated_unit_refuses_is_named(tmp_path: Path) -> None:
    """At one node film takes light of two opposite quadrants of a Gaussian beam, which does not move it."""
    node = grid(6, 5)[8]

    def beam(place: tuple[float, float], u_px: np.ndarray, v_px: np.ndarray) -> np.ndarray:
        light = np.exp(-2 * (u_px**2 + v_px**2) / 20**2)
        return np.where((u_px * v_px > 0) & (place == node), 0.6 * light, light)

    result = calibrate([open_recording(write_scan(tmp_path / "scan", picture=picture_of(beam)))])
    assert [[place for place, _ in of.unmeasured] for of in result.evidence] == 2 * [[node]]
    assert [line.split(": ")[:3] for line in result.doubts] == [
        [f"{name} node x -12.5 y -25 mm", "the unit would not measure its spot", "distorted"]
        for name in ("front", "rear")
    ]
