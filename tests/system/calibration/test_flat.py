"""Flats of a simulated unit; flats made with the laser itself, whose response, spot and map are formulas."""

import csv
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.recordings import grid

from altd.calibration.calibrating import calibrate
from altd.calibration.recorded_flat import flat_correlation, flats_of
from altd.calibration.result import CalibrationResult
from altd.calibration.target_frames import target_frames
from altd.errors import BadInputError
from altd.measuring.calibration import Calibration
from altd.recording.reader import Recording, open_recording
from altd.records import Frame, Spot
from altd.vision.flat import Flat
from altd.vision.localise import locate
from hw_sim.measure import random_poses
from hw_sim.unit import Unit, UnitConfig

SEED = 3


@pytest.fixture(scope="module")
def unit() -> Unit:
    return Unit(UnitConfig(seed=SEED))


@pytest.fixture(scope="module")
def scan(unit_3: Path) -> Recording:
    return open_recording(unit_3 / "scan")


@pytest.fixture(scope="module")
def flats(scan: Recording, flat_of_unit_3: Path) -> dict[str, Flat]:
    return flats_of(open_recording(flat_of_unit_3), target_frames([scan]))


def correlation(flat: Flat, unit: Unit, camera: str) -> float:
    """Correlation with the true response where the flat says anything: not at hot pixels."""
    known = flat.levels > 0
    assert np.mean(known) > 0.999
    return float(np.corrcoef(flat.response[known], unit.imagers[camera].view.response[known])[0, 1])


@pytest.mark.parametrize("camera", ["front", "rear"])
def test_a_flat_is_what_the_pixels_show_of_even_light(
    flats: dict[str, Flat], unit: Unit, camera: str
) -> None:
    assert flats[camera].source == "recording"
    assert flats[camera].response.mean() == pytest.approx(1.0)
    assert correlation(flats[camera], unit, camera) > 0.97


def test_a_flat_of_another_camera_is_refused(scan: Recording, flat_of_unit_3: Path) -> None:
    """The flat was recorded by the rear camera's successor."""
    flat = open_recording(flat_of_unit_3)
    sizes = scan.header.cameras
    cameras = {name: size.model_copy(update={"serial": f"{name}-1"}) for name, size in sizes.items()}
    others = {**cameras, "rear": cameras["rear"].model_copy(update={"serial": "rear-2"})}
    flat = replace(flat, header=flat.header.model_copy(update={"cameras": others}))
    scan = replace(scan, header=scan.header.model_copy(update={"cameras": cameras}))
    with pytest.raises(BadInputError, match=r"rear: the flat is of another camera .* 'rear-2'"):
        flats_of(flat, target_frames([scan]))


def test_light_that_is_switched_off_during_the_recording_tells_the_dark_rows(
    scan: Recording, flat_of_unit_3: Path, flats: dict[str, Flat], tmp_path: Path
) -> None:
    """As ``altd record`` writes it: no row says that it is lit, and one frame falls into the switching."""
    copy = tmp_path / "flat"
    with (flat_of_unit_3 / "frames.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    for camera in ("front", "rear"):
        (copy / camera).mkdir(parents=True)
    for row in rows:
        pixels = cv2.imread(str(flat_of_unit_3 / row["file"]), cv2.IMREAD_UNCHANGED)
        if row["sequence"] == "8":
            pixels = pixels // 2
        cv2.imwrite(str(copy / row["file"]), pixels)
        row["leds"] = "off"
    with (copy / "frames.csv").open("w", newline="") as table:
        writer = csv.DictWriter(table, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    (copy / "recording.json").write_text((flat_of_unit_3 / "recording.json").read_text())
    switched = flats_of(open_recording(copy), target_frames([scan]))
    for camera, flat in flats.items():
        assert np.corrcoef(switched[camera].response.ravel(), flat.response.ravel())[0, 1] > 0.99
        assert np.percentile(np.abs(switched[camera].response - flat.response), 99) < 0.1


def errors_of(calibration: Calibration, unit: Unit) -> tuple[float, float]:
    """Rms of x and y, mm, and of yaw and pitch, degrees, over twenty random beams of four exposures."""
    off_mm, off_deg = [], []
    for number, pose in enumerate(random_poses(20, 280.0, np.random.default_rng(1))):
        unit.place(pose)
        points = []
        for target in calibration.targets:
            spots = [
                locate(unit.expose(target.name, 4 * number + n, 0), target.localiser, target.flat)
                for n in range(4)
            ]
            mean_px = np.mean([(s.u_px, s.v_px) for s in spots if isinstance(s, Spot)], axis=0)
            point = target.point(*mean_px)
            assert point is not None
            points.append(np.array([point.x_mm, point.y_mm]))
        off_mm.append(points[0] - pose.at(0.0))
        slopes = (points[1] - points[0]) / 280.0
        off_deg.append(np.degrees(np.arctan(slopes)) - (pose.yaw_deg, pose.pitch_deg))
    return float(np.sqrt(np.mean(np.square(off_mm)))), float(np.sqrt(np.mean(np.square(off_deg))))


def test_with_a_flat_a_unit_measures_several_times_as_well(
    unit_3_with_flat: CalibrationResult, unit: Unit
) -> None:
    result = unit_3_with_flat
    assert result.remarks[:2] == (
        "front: localised through its recorded flat",
        "rear: localised through its recorded flat",
    )
    assert result.doubts == ()
    off_mm, off_deg = errors_of(result.calibration, unit)
    assert off_mm < 0.004
    assert off_deg < 0.0010


@pytest.mark.parametrize("camera", ["front", "rear"])
def test_a_flat_of_other_pixels_is_told_from_the_right_one(
    scan: Recording, flats: dict[str, Flat], camera: str
) -> None:
    frames = [scan.frame(row) for row in scan.rows if row.camera == camera and row.position_mm][::6]
    assert flat_correlation(frames, flats[camera]) > 0.75
    for moved_px in ((0, 1), (1, 0), (0, -2), (30, 40)):
        moved = Flat(np.roll(flats[camera].levels, moved_px, (0, 1)), "recording")
        assert flat_correlation(frames, moved) < 0.55, moved_px
    assert np.isnan(flat_correlation(frames, Flat(np.full((480, 752), 200, np.uint8), "recording")))


def test_without_a_flat_the_print_is_found_and_the_plain_plate_is_seen_to_be_plain(
    unit_3: Path, calibration_of_unit_3: Calibration, unit: Unit
) -> None:
    said = (unit_3 / "calibrated").read_text().splitlines()
    assert {"front: print of 1.000 mm pitch found and modelled", "rear: plain, no print"} <= set(said)
    front, rear = calibration_of_unit_3.targets
    assert (front.localiser.method, rear.localiser.method) == ("profile", "profile")
    assert (front.flat is not None, rear.flat) == (True, None)
    assert front.flat is not None
    assert correlation(front.flat, unit, "front") > 0.95
    off_mm, off_deg = errors_of(calibration_of_unit_3, unit)
    assert off_mm < 0.012
    assert off_deg < 0.0035


WIDTH, HEIGHT = 240, 160
PX_PER_MM = 2.0
RADIUS_MM = 6.0
BLACK, PEAK = 8.0, 150.0
HOT = 70, 90

Place = tuple[float, float]


def surface(seed: int) -> np.ndarray:
    """Grain that a lens has blurred a little, on a slope such as a lens's fall-off."""
    grain = np.random.default_rng(seed).normal(0, 0.25, (HEIGHT, WIDTH))
    return (1 + cv2.GaussianBlur(grain, (0, 0), 0.8)) * np.linspace(0.9, 1.1, WIDTH)


@dataclass(frozen=True)
class RasterUnit:
    """A camera that sees 1 mm as 2 px, and a laser; ``power`` is by the number of the exposure.

    ``sign_x`` -1: the stage runs against the x that it says.
    """

    response: np.ndarray
    rng: np.random.Generator
    peak: float = PEAK
    power: Callable[[int], float] = lambda _number: 1.0
    sign_x: float = 1.0

    def picture(self, place: Place | None, number: int = 0) -> np.ndarray:
        v, u = np.mgrid[:HEIGHT, :WIDTH]
        counts = np.full((HEIGHT, WIDTH), BLACK) + u / 100
        if place is not None:
            x_mm, y_mm = (u - 119.5) / PX_PER_MM, (79.5 - v) / PX_PER_MM
            squared = (x_mm - self.sign_x * place[0]) ** 2 + (y_mm - place[1]) ** 2
            counts += self.peak * self.power(number) * self.response * np.exp(-2 * squared / RADIUS_MM**2)
        counts[HOT] += 90
        counts += self.rng.normal(0, 1.0, counts.shape)
        return np.clip(np.rint(counts), 0, 255).astype(np.uint8)

    def record(
        self, path: Path, kind: str, places: Iterable[Place | None], serial: str = "TEST-1"
    ) -> Recording:
        (path / "rear").mkdir(parents=True)
        size = {"width": WIDTH, "height": HEIGHT, "bits": 8}
        about = {
            "format": "altd-recording/1",
            "kind": kind,
            "fps": 20.0,
            "cameras": {"rear": size},
            "unit": {"serial": serial, "target_distance_mm": 280.0},
        }
        (path / "recording.json").write_text(json.dumps(about))
        with (path / "frames.csv").open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(("sequence", "t_s", "camera", "file", "leds", "x_mm", "y_mm"))
            for n, place in enumerate(places):
                cv2.imwrite(str(path / "rear" / f"{n}.png"), self.picture(place, n))
                table.writerow((n, n / 20, "rear", f"rear/{n}.png", "off", *(place or ("", ""))))
        return open_recording(path)


def raster(pitch_mm: float, half_x_mm: float = 50.0, half_y_mm: float = 38.0) -> list[Place]:
    """The nodes of the scan reach 40 and 30 mm, their spots 9 mm further."""
    x, y = (np.arange(-half, half + 1e-6, pitch_mm) for half in (half_x_mm, half_y_mm))
    return [(float(a), float(b)) for b in y for a in x]


def unit_of(seed: int, noise: int = 1) -> RasterUnit:
    return RasterUnit(surface(seed), np.random.default_rng(noise))


@pytest.fixture(scope="module")
def raster_scan(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return unit_of(1).record(tmp_path_factory.mktemp("scan") / "scan", "scan", grid(5, 4, 20.0))


@pytest.fixture(scope="module")
def laser_flat(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Dark exposures first; a laser whose power scatters by 3 %."""
    powers = np.random.default_rng(5).normal(1, 0.03, 2000)
    unit = replace(unit_of(1, 2), power=lambda number: float(powers[number]))
    places = [None] * 5 + raster(3.0)
    return unit.record(tmp_path_factory.mktemp("flat") / "flat", "flat", places)


def relative_error(flat: Flat, response: np.ndarray, band_px: tuple[float, float] | None = None) -> float:
    """Rms of flat over response within the nodes, the mean taken off; between two sigmas of blur."""
    ratio = flat.response / response
    ratio = np.where(flat.levels > 0, ratio, np.median(ratio)) / np.mean(ratio[20:140, 40:200])
    if band_px is not None:
        fine, coarse = (cv2.GaussianBlur(ratio, (0, 0), sigma) for sigma in band_px)
        ratio = fine - coarse
    return float(np.std(ratio[20:140, 40:200]))


def test_the_response_comes_out_of_spots_that_overlap(raster_scan: Recording, laser_flat: Recording) -> None:
    """A pixel has noise; what displaces a spot are differences over its size, of which little is left."""
    flat = flats_of(laser_flat, target_frames([raster_scan]))["rear"]
    assert flat.source == "laser"
    assert flat.response[HOT] == 0
    assert np.mean(flat.levels[20:140, 40:200] == 0) < 1e-3
    assert relative_error(flat, surface(1), (0.5, 4.0)) < 0.006
    assert relative_error(flat, surface(2), (0.5, 4.0)) > 0.1  # the surface of another unit


def errors_mm(scan: Recording, flat: Recording | None) -> float:
    """Rms of x and y over forty spots, each the mean of four exposures."""
    (target,) = calibrate([scan], flat).calibration.targets
    unit, off = unit_of(1, 3), []
    for place in np.random.default_rng(4).uniform(-1, 1, (40, 2)) * (38, 28):
        frames = [Frame("rear", n, n, unit.picture(tuple(place)), 8, False) for n in range(4)]
        spots = [locate(frame, target.localiser, target.flat) for frame in frames]
        mean_px = np.mean([(spot.u_px, spot.v_px) for spot in spots if isinstance(spot, Spot)], axis=0)
        point = target.point(*mean_px)
        assert point is not None
        off.append((point.x_mm - place[0], point.y_mm - place[1]))
    return float(np.sqrt(np.mean(np.square(off))))


def test_a_flat_of_the_laser_removes_what_a_lamp_shows_wrongly(
    tmp_path: Path, raster_scan: Recording, laser_flat: Recording
) -> None:
    """A lamp that shows the grain of the surface only in part, since it shines from all sides."""
    lit = np.clip(BLACK + 120 * (0.5 * surface(1) + 0.5 * surface(7)), 0, 255)
    lamp = RasterUnit(surface(1), np.random.default_rng(6)).record(tmp_path / "lamp", "flat", [None] * 3)
    for n in range(3):
        cv2.imwrite(str(lamp.path / "rear" / f"{n}.png"), np.rint(lit).astype(np.uint8))
    without, by_lamp, by_laser = (errors_mm(raster_scan, flat) for flat in (None, lamp, laser_flat))
    assert by_laser < 0.4 * by_lamp
    assert by_laser < 0.25 * without


@pytest.mark.parametrize(
    ("unit", "places", "complaint"),
    [
        (unit_of(1), raster(12.0), r"rear: no exposure lights x -?\d+ y -?\d+ mm: the spot has 12 mm"),
        (unit_of(1), raster(4.0, half_x_mm=30.0), r"rear: no exposure lights x -?(39|40) y -?\d+ mm"),
        (unit_of(1), raster(4.0)[:9], r"rear: no exposure lights"),
        (unit_of(2), raster(4.0), r"rear: the flat does not match the spots of the scan \("),
        (replace(unit_of(1), sign_x=-1.0), raster(4.0), r"rear: "),
        (replace(unit_of(1), peak=400.0), raster(4.0), r"rear: too bright to be a flat: \d+% of the pixels"),
        (replace(unit_of(1), peak=3.0), raster(4.0), r"rear: too dark to be a flat: its spots have \d\.\d"),
        (
            replace(unit_of(1), power=lambda number: float(number % 3 == 0)),
            raster(4.0),
            r"rear: \d+ of \d+ exposures have no spot of the usual light at the stage's position",
        ),
    ],
)
def test_what_is_no_flat_of_the_scan_is_refused(
    tmp_path: Path, raster_scan: Recording, unit: RasterUnit, places: list[Place], complaint: str
) -> None:
    flat = unit.record(tmp_path / "flat", "flat", places)
    with pytest.raises(BadInputError, match=complaint) as caught:
        flats_of(flat, target_frames([raster_scan]))
    assert "\n" not in str(caught.value)


def test_one_of_another_unit_is_refused(tmp_path: Path, raster_scan: Recording) -> None:
    flat = unit_of(1).record(tmp_path / "flat", "flat", raster(20.0), "TEST-2")
    with pytest.raises(BadInputError, match=r"is a flat of unit 'TEST-2', the scan is of unit 'TEST-1'"):
        flats_of(flat, target_frames([raster_scan]))
