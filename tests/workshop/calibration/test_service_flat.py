"""A flat learnt from the spots of service, on a unit that is drawn from the optics alone."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from support import optics
from support.measurements import beam_chain

from altd.calibration import service_flat
from altd.calibration.calibrating import calibrate
from altd.calibration.file import load_calibration, save_calibration
from altd.calibration.from_scans import calibrate_scans
from altd.calibration.result import CalibrationResult, TargetsResult
from altd.calibration.service_flat import with_service
from altd.calibration.target_frames import TargetFrames, target_frames
from altd.config import Measuring
from altd.errors import BadInputError
from altd.measuring.calibration import Calibration
from altd.recording.reader import open_recording
from altd.records import Frame
from altd.vision.flat import Flat, Learnt

REACH_MM = 36.0, 28.0
SPOTS, BEAMS = 320, 20
KEYS = "x_mm", "y_mm", "yaw_deg", "pitch_deg"


@dataclass(frozen=True)
class Drawn:
    """A unit with its scan, its service at a constant power, and beams of which the truth is known."""

    unit: optics.Unit
    scan: Path
    service: Path
    beams: Sequence[optics.Beam]


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    folder, unit = tmp_path_factory.mktemp("drawn"), optics.Unit(seed=2)
    spots = optics.random_beams(SPOTS, 5, REACH_MM)
    return Drawn(
        unit,
        optics.write(folder / "scan", "scan", optics.scan(unit)),
        optics.write(folder / "service", "measurement", optics.poses(unit, spots, exposures=1)),
        optics.random_beams(BEAMS, 6, (REACH_MM[0] - 5.0, REACH_MM[1] - 5.0)),
    )


@pytest.fixture(scope="module")
def scanned(drawn: Drawn) -> Sequence[TargetFrames]:
    return target_frames([open_recording(drawn.scan)])


@pytest.fixture(scope="module")
def before(scanned: Sequence[TargetFrames]) -> TargetsResult:
    return calibrate_scans(scanned, {}, no_progress)


@pytest.fixture(scope="module")
def learnt(drawn: Drawn) -> CalibrationResult:
    return calibrate([open_recording(drawn.scan)], service=open_recording(drawn.service))


def no_progress(_done: int, _total: int) -> None:
    pass


def errors(made: Calibration, drawn: Drawn) -> tuple[np.ndarray, np.ndarray]:
    """Errors (n, 4) of the beams, and their sigmas."""
    chain = beam_chain(made, Measuring(window=4, every=4))
    frames = (
        Frame(name, round(t_s * optics.FPS), round(t_s * 1e9), picture)
        for t_s, name, picture, _ in optics.poses(drawn.unit, drawn.beams, exposures=4, seed=7)
    )
    found = [measurement for frame in frames for measurement in chain.push(frame)]
    truths = [
        (of.x, of.y, np.degrees(np.arctan(of.slope_x)), np.degrees(np.arctan(of.slope_y)))
        for of in drawn.beams
    ]
    pairs = [(each, truth) for each, truth in zip(found, truths, strict=True) if each.valid]
    assert len(pairs) >= BEAMS - 2
    values = np.array([[each.values[key].value for key in KEYS] for each, _ in pairs])
    sigmas = np.array([[each.values[key].sigma for key in KEYS] for each, _ in pairs])
    return values - np.array([truth for _, truth in pairs]), sigmas


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(values), axis=0))


def test_a_unit_measures_twice_as_well(
    drawn: Drawn, before: TargetsResult, learnt: CalibrationResult
) -> None:
    without, _ = errors(replace(learnt.calibration, targets=before.targets), drawn)
    found, sigmas = errors(learnt.calibration, drawn)
    assert (rms(found) < 0.6 * rms(without)).all()
    z = rms(found / sigmas)
    assert 0.5 < rms(z) < 1.4  # a unit has few independent errors: its map's are those of all beams
    flats = [target.flat for target in learnt.calibration.targets]
    assert [flat.source for flat in flats if flat] == ["service"] * 2
    assert sum("the nodes on the learnt flat scatter by" in line for line in learnt.remarks) == 2


def test_a_spot_beyond_what_is_learnt_has_the_sigma_of_a_unit_without(learnt: CalibrationResult) -> None:
    for target in learnt.calibration.targets:
        assert target.flat is not None
        assert target.flat.learnt is not None
        inside, outside = (target.map.to_px(np.array([at]))[0] for at in ((0.0, 0.0), (60.0, 45.0)))
        assert target.flat.learnt.of_spot(*inside) > 0.95
        assert target.flat.learnt.of_spot(*outside) < 0.05
        near, far = target.point(*inside), target.point(*outside)
        assert near is not None
        assert far is not None
        assert far.covariance_mm2.trace() > 4 * near.covariance_mm2.trace()


def test_it_survives_its_file(learnt: CalibrationResult, tmp_path: Path) -> None:
    path = tmp_path / "cal.json"
    save_calibration(learnt.calibration, path)
    read = load_calibration(path, "OPTICS-1")
    for before, after in zip(learnt.calibration.targets, read.targets, strict=True):
        places = [before.map.to_px(np.array([at]))[0] for at in ((0.0, 0.0), (33.0, 20.0))]
        for u_px, v_px in places:
            one, other = before.point(u_px, v_px), after.point(u_px, v_px)
            assert one is not None
            assert other is not None
            assert other.covariance_mm2 == pytest.approx(one.covariance_mm2, rel=1e-6)


def changed(drawn: Drawn, folder: Path, **header: object) -> Path:
    shutil.copytree(drawn.service, folder / "other")
    place = folder / "other" / "recording.json"
    place.write_text(json.dumps(json.loads(place.read_text()) | header))
    return folder / "other"


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ({"kind": "flat"}, "is of kind 'flat', not 'measurement'"),
        (
            {"unit": {"serial": "OTHER", "target_distance_mm": 280.0}},
            "is of unit 'OTHER', the scan of 'OPTICS-1'",
        ),
    ],
)
def test_another_recording_is_refused(
    drawn: Drawn, tmp_path: Path, header: dict[str, object], said: str
) -> None:
    with pytest.raises(BadInputError, match=said):
        calibrate([open_recording(drawn.scan)], service=open_recording(changed(drawn, tmp_path, **header)))


def test_a_beam_that_stays_is_refused(
    drawn: Drawn, scanned: Sequence[TargetFrames], before: TargetsResult, tmp_path: Path
) -> None:
    at_rest = optics.poses(drawn.unit, [optics.Beam()], exposures=30)
    rest = optics.write(tmp_path / "rest", "measurement", at_rest)
    with pytest.raises(BadInputError, match="1 exposures show both targets at a new place, 200 are needed"):
        with_service(scanned, before, open_recording(rest), no_progress)


def test_a_flat_that_hides_the_scan_is_refused(
    drawn: Drawn, scanned: Sequence[TargetFrames], before: TargetsResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    nothing = Learnt.of(np.ones((120, 188)), 0.1, 30.0)
    black = Flat.from_response(np.zeros((480, 752)), "service", learnt=nothing)
    rng = np.random.default_rng(1)
    powers = {number: np.array([1.0, *rng.uniform(-30.0, 30.0, 2)]) for number in range(200)}
    monkeypatch.setattr(service_flat, "_new_places", lambda *_: list(range(200)))
    monkeypatch.setattr(service_flat.Service, "learn", lambda *_: (black, powers))
    with pytest.raises(BadInputError, match="service: front: through its flat 0 nodes of the scan"):
        with_service(scanned, before, open_recording(drawn.service), no_progress)


def test_a_laser_whose_power_scatters_is_refused(
    drawn: Drawn, scanned: Sequence[TargetFrames], before: TargetsResult, tmp_path: Path
) -> None:
    rng = np.random.default_rng(8)
    spots = [
        replace(of, power=of.power * (1.0 + rng.normal(0.0, 0.012)))
        for of in optics.random_beams(240, 5, REACH_MM)
    ]
    path = optics.write(tmp_path / "service", "measurement", optics.poses(drawn.unit, spots, exposures=1))
    with pytest.raises(BadInputError, match=r"the laser's power scatters by 1\.\d %; 0\.5 % at most"):
        with_service(scanned, before, open_recording(path), no_progress)


def test_a_plate_that_was_moved_by_5_mm_gives_no_flat(
    drawn: Drawn,
    scanned: Sequence[TargetFrames],
    before: TargetsResult,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    other = optics.Unit(drawn.unit.seed, rear_shift_mm=(4.0, 3.0))
    spots = optics.random_beams(240, 5, REACH_MM)
    path = optics.write(tmp_path / "service", "measurement", optics.poses(other, spots, exposures=1))
    monkeypatch.setattr(service_flat, "PASSES", 1)  # more do not change the verdict
    made = with_service(scanned, before, open_recording(path), no_progress)
    assert {target.name: target.flat and target.flat.source for target in made.targets}["rear"] is None
    (said,) = (line for line in made.remarks if line.startswith("rear: the nodes on the learnt flat"))
    assert said.endswith("px without: it is not used")
