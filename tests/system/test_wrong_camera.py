"""Pictures that are not those of the calibrated cameras: not one of them may become a valid measurement.

A window of a single exposure is the hardest case: the first pair of frames must be seen through. Two units
are rendered and calibrated once, which takes ten seconds each.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.measurements import beam_of
from support.unit_toml import TARGETS

from altd.app.daemon import Daemon
from altd.calibration.calibrating import calibrate
from altd.calibration.file import load_calibration
from altd.config import Config, Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.measuring.frame_chain import Provenance
from altd.recording.reader import open_recording
from altd.records import CameraIdentity, Frame, Measurement
from altd.vision.hot_pixels import HotPixels, places_of
from hw_sim.beam import BeamPose
from hw_sim.camera import make_cameras
from hw_sim.scan import record_scan
from hw_sim.stage import Stage
from hw_sim.targets import DotPattern
from hw_sim.unit import Unit, UnitConfig

VIEWS = (View("front", "front"), View("rear", "rear"))
POSES = (
    BeamPose(3.0, -4.0, 0.01, 0.02),
    BeamPose(-37.0, 21.0, 0.05, -0.1),
    BeamPose(49.0, -33.0, -0.1, 0.12),
)
NO_HOT_PIXELS = HotPixels(places_of([]), places_of([]))

Pictures = tuple[np.ndarray, np.ndarray]
Spoil = Callable[[np.ndarray, np.ndarray], Pictures]


def mirrored(pixels: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(pixels[:, ::-1])


def moved(pixels: np.ndarray, u: int, v: int) -> np.ndarray:
    matrix = np.array([[1.0, 0, u], [0, 1, v]])
    return cv2.warpAffine(
        pixels, matrix, pixels.shape[::-1], flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE
    )


SPOILT: dict[str, Spoil] = {
    "exchanged": lambda front, rear: (rear, front),
    "mirrored": lambda front, rear: (mirrored(front), mirrored(rear)),
    "mirrored front": lambda front, rear: (mirrored(front), rear),
    "mirrored rear": lambda front, rear: (front, mirrored(rear)),
    "front 1 px aside": lambda front, rear: (moved(front, 1, 0), rear),
    "rear 1 px lower": lambda front, rear: (front, moved(rear, 0, 1)),
    "front 4 px aside": lambda front, rear: (moved(front, 4, 0), rear),
    "rear 4 px aside": lambda front, rear: (front, moved(rear, -4, 0)),
    "front twice": lambda front, rear: (front, front),
}


REFUSED = {f"{target}_{reason}" for target in ("front", "rear") for reason in ("wrong_camera", "distorted")}
"""Light on another print than the flat's is not that of one spot either."""


@pytest.fixture(scope="module", params=[1, 2])
def seed(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(scope="module")
def calibration(seed: int, simulated_unit: Callable[[int], Path]) -> Calibration:
    return load_calibration(simulated_unit(seed) / "cal.json")


@pytest.fixture(scope="module")
def pictures(seed: int) -> list[Pictures]:
    return exposed(seed)


def exposed(seed: int) -> list[Pictures]:
    unit = Unit(UnitConfig(seed=seed))
    both = []
    for number, pose in enumerate(POSES):
        unit.place(pose)
        front, rear = (unit.expose(camera, number, 0).pixels for camera in ("front", "rear"))
        both.append((front, rear))
    return both


def again(seed: int, count: int, pose: int = 0) -> list[Pictures]:
    """The right cameras' pictures of one beam, each with a noise of its own."""
    unit = Unit(UnitConfig(seed=seed))
    unit.place(POSES[pose])
    return [
        (unit.expose("front", number, 0).pixels, unit.expose("rear", number, 0).pixels)
        for number in range(100, 100 + count)
    ]


def chain(
    calibration: Calibration,
    window: int = 1,
    identity: Callable[[str], CameraIdentity | None] = lambda camera: None,
    views: Sequence[View] = VIEWS,
) -> MeasuringChain:
    measuring = Measuring(window=window)
    provenance = Provenance(identity=identity)
    return MeasuringChain(views, calibration, measuring, BeamInstrument(calibration, measuring), provenance)


def measured(chain: MeasuringChain, pictures: Sequence[Pictures], first: int = 0) -> list[Measurement]:
    return [
        measurement
        for number, pair in enumerate(pictures, first)
        for camera, pixels in zip(("front", "rear"), pair, strict=True)
        for measurement in chain.push(Frame(camera, number, number * 50_000_000, pixels))
    ]


def status(measurement: Measurement) -> set[str]:
    """Without what every measurement of this unit says."""
    return {str(fault) for fault in measurement.status} - {"simulated", "rehearsal"}


def without_hot_pixels(calibration: Calibration) -> Calibration:
    """As of sensors that have none, or of a camera that moved in its holder: those stay in place."""
    targets = []
    for target in calibration.targets:
        assert target.fingerprint is not None
        targets.append(replace(target, fingerprint=replace(target.fingerprint, hot=NO_HOT_PIXELS)))
    return replace(calibration, targets=tuple(targets))


def test_the_right_cameras_measure_from_the_first_frame_on(
    calibration: Calibration, pictures: list[Pictures]
) -> None:
    for known in (calibration, without_hot_pixels(calibration)):
        assert all(measurement.valid for measurement in measured(chain(known), pictures))


@pytest.mark.parametrize("name", SPOILT)
def test_not_one_spoilt_picture_is_measured(
    calibration: Calibration, pictures: list[Pictures], name: str
) -> None:
    for pair in pictures:
        (measurement,) = measured(chain(calibration), [SPOILT[name](*pair)])
        assert not measurement.valid
        assert status(measurement) & {"front_wrong_camera", "rear_wrong_camera"}
        assert all(fault.detail for fault in measurement.status)


@pytest.mark.parametrize(
    "name", ["exchanged", "mirrored", "mirrored front", "front 1 px aside", "front twice"]
)
def test_the_print_tells_it_without_any_hot_pixel(
    calibration: Calibration, pictures: list[Pictures], name: str
) -> None:
    for pair in pictures:
        (measurement,) = measured(chain(without_hot_pixels(calibration)), [SPOILT[name](*pair)])
        assert status(measurement) & REFUSED


def test_the_grain_of_a_plain_plate_shows_a_shift_in_health_and_refuses_nothing(
    calibration: Calibration, seed: int
) -> None:
    """The edge of another laser's spot, which moves with it, can look like a shifted grain."""
    unit = Unit(UnitConfig(seed=seed))
    unit.place(BeamPose(12.0, 3.0))
    front, rear = (unit.expose(camera, 0, 0).pixels for camera in ("front", "rear"))
    measuring = chain(without_hot_pixels(calibration))
    (measurement,) = measured(measuring, [(front, moved(rear, 1, 0))])
    assert measurement.valid
    assert "could not be verified: the picture lies u +" in str(measuring.views()["view_rear"])


def test_another_unit_under_this_serial_is_not_measured(calibration: Calibration, seed: int) -> None:
    for pair in exposed(seed + 100):
        for known in (calibration, without_hot_pixels(calibration)):
            (measurement,) = measured(chain(known), [pair])
            assert status(measurement) & REFUSED


def test_cameras_that_are_exchanged_and_put_back_are_noticed_at_once(
    calibration: Calibration, seed: int
) -> None:
    pictures = again(seed, 24)
    exchanged = [SPOILT["exchanged"](*pair) for pair in pictures[8:16]]
    lines = measured(chain(calibration, window=4), [*pictures[:8], *exchanged, *pictures[16:]])
    valid = [line.valid for line in lines]
    assert valid[1:8] == [True] * 7
    assert not any(valid[8:16])
    assert valid[17:] == [True] * 7


def test_a_camera_that_is_knocked_while_it_measures_is_noticed_by_the_jump_of_its_spot(
    calibration: Calibration, seed: int
) -> None:
    pictures = again(seed, 20)
    aside = [SPOILT["front 1 px aside"](*pair) for pair in pictures[8:]]
    lines = measured(chain(without_hot_pixels(calibration), window=4), [*pictures[:8], *aside])
    invalid = [number for number, line in enumerate(lines) if "front_wrong_camera" in status(line)]
    assert invalid == list(range(8, 20))


@pytest.mark.parametrize("far_px", [0.1, 0.2, 0.3])
def test_a_picture_that_moved_by_less_than_is_refused_is_uncertain_by_so_much(
    calibration: Calibration, pictures: list[Pictures], far_px: float
) -> None:
    """Heat, or a knock: the front picture lies aside by a part of a pixel."""
    for front, rear in pictures:
        there = np.array([[1.0, 0.0, far_px], [0.0, 1.0, 0.0]])
        aside = cv2.warpAffine(front, there, front.shape[::-1], flags=cv2.INTER_LANCZOS4)
        (good,) = measured(chain(without_hot_pixels(calibration)), [(front, rear)])
        (moved_aside,) = measured(chain(without_hot_pixels(calibration)), [(aside, rear)])
        assert beam_of(good) is not None
        assert beam_of(moved_aside) is not None
        error_mm = abs(beam_of(moved_aside).x_mm - beam_of(good).x_mm)
        assert error_mm > 0.15 * far_px
        assert error_mm < 2.5 * beam_of(moved_aside).sigma_x_mm
        assert beam_of(moved_aside).sigma_x_mm < beam_of(good).sigma_x_mm + 2 * error_mm


def test_a_coarse_print_is_no_doubled_picture(tmp_path: Path) -> None:
    """Dots of 1 mm, 2 mm from each other (Table 3.1): nothing is wrong with a unit that has them."""
    unit = Unit(UnitConfig(seed=5, dots=DotPattern(1.0, 2.0, hexagonal=False)))
    unit.set_camera("front", exposure_ms=1.4)  # its dots are larger and brighter
    record_scan(tmp_path / "scan", unit, Stage(np.random.default_rng(5)), 1, lambda *_: None)
    known = calibrate([open_recording(tmp_path / "scan")]).calibration
    unit.leds_on = False
    for number, pose in enumerate(POSES):
        unit.place(pose)
        front, rear = (unit.expose(camera, number, 0).pixels for camera in ("front", "rear"))
        (measurement,) = measured(chain(known), [(front, rear)])
        assert beam_of(measurement) is not None, measurement.status
        assert beam_of(measurement).sigma_x_mm < 0.06


class TestIdentities:
    def calibrated(self, calibration: Calibration) -> Calibration:
        front, rear = calibration.targets
        named = replace(front, camera=CameraIdentity("F-1", "mini", "aravis"), fingerprint=None)
        return replace(calibration, targets=(named, replace(rear, fingerprint=None)))

    @pytest.mark.parametrize(
        ("plugged", "word"),
        [
            (CameraIdentity("R-1", "mini", "aravis"), "its serial is 'R-1', expected 'F-1'"),
            (CameraIdentity(None, "maxi", "aravis"), "its model is 'maxi', expected 'mini'"),
        ],
    )
    def test_another_camera_is_invalid_until_the_right_one_is_back(
        self, calibration: Calibration, seed: int, plugged: CameraIdentity, word: str
    ) -> None:
        pictures = again(seed, 6)
        right = CameraIdentity("F-1", "mini", "aravis")
        there = {"front": right, "rear": None}
        measuring = chain(self.calibrated(calibration), identity=there.__getitem__)
        assert all(m.valid for m in measured(measuring, pictures[:2]))
        there["front"] = plugged
        lines = measured(measuring, pictures[2:4], first=2)
        assert [status(line) for line in lines] == [{"front_wrong_camera"}] * 2
        assert word in lines[0].status[0].detail
        there["front"] = right
        assert all(m.valid for m in measured(measuring, pictures[4:], first=4))

    @pytest.mark.parametrize(
        "plugged", [None, CameraIdentity(), CameraIdentity("F-1"), CameraIdentity("other", "x", "v4l2")]
    )
    def test_what_cannot_be_compared_is_no_objection(
        self, calibration: Calibration, pictures: list[Pictures], plugged: CameraIdentity | None
    ) -> None:
        measuring = chain(self.calibrated(calibration), identity=lambda _: plugged)
        assert measured(measuring, pictures[:1])[0].valid

    def test_the_serial_of_the_config_counts_beside_that_of_the_calibration(
        self, calibration: Calibration, pictures: list[Pictures]
    ) -> None:
        measuring = chain(
            self.calibrated(calibration),
            identity=lambda camera: CameraIdentity(f"{camera}-2", driver="v4l2"),
            views=(VIEWS[0], View("rear", "rear", CameraIdentity("rear-1"))),
        )
        assert status(measured(measuring, pictures[:1])[0]) == {"rear_wrong_camera"}


def test_the_daemon_holds_its_cameras_against_the_config(
    calibration: Calibration, pictures: list[Pictures], tmp_path: Path
) -> None:
    """Cameras that are there, pictures that are right; only the rear camera's name is another one."""
    camera = {"driver": "v4l2", "device": "/dev/null", "fps": 20}
    config = Config.model_validate(
        {
            "unit": {"serial": calibration.unit_serial, "calibration": tmp_path / "cal.json"},
            "targets": TARGETS,
            "cameras": {"front": camera, "rear": {**camera, "serial": "R-9"}},
            "measuring": {"pair_by": "time", "window": 1},
        }
    )
    cameras = {camera.name: camera for camera in make_cameras(Unit(UnitConfig(seed=5)))}
    (measurement,) = measured(Daemon(config, calibration, cameras).chain, pictures[:1])
    assert {str(fault) for fault in measurement.status} == {"rear_wrong_camera", "simulated"}
    assert "its serial is 'SIM-5-rear', expected 'R-9'" in measurement.status[0].detail


@pytest.fixture(scope="module")
def foreign(shared_data: Path, unit_a: Path) -> tuple[Calibration, list[Pictures]]:
    """Frames that this project did not make: the calibration, and the first exposure of each of 12 beams."""
    calibration = load_calibration(unit_a / "cal.json")
    poses = open_recording(shared_data / "unit-a" / "poses")
    frames = {(row.sequence, row.camera): poses.frame(row).pixels for row in poses.rows}
    return calibration, [(frames[4 * pose, "front"], frames[4 * pose, "rear"]) for pose in range(12)]


def test_the_cameras_of_unit_a_measure(foreign: tuple[Calibration, list[Pictures]]) -> None:
    calibration, beams = foreign
    assert all(measurement.valid for pair in beams for measurement in measured(chain(calibration), [pair]))


@pytest.mark.parametrize("name", SPOILT)
def test_not_one_spoilt_picture_of_unit_a_is_measured(
    foreign: tuple[Calibration, list[Pictures]], name: str
) -> None:
    calibration, beams = foreign
    for pair in beams:
        (measurement,) = measured(chain(calibration), [SPOILT[name](*pair)])
        assert status(measurement) & {"front_wrong_camera", "rear_wrong_camera"}
