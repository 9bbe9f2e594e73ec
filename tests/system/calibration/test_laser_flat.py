"""Flats made with the laser itself, from frames whose response, spot and map are formulas."""

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
from altd.calibration.recorded_flat import flats_of
from altd.calibration.target_frames import target_frames
from altd.errors import BadInputError
from altd.recording.reader import Recording, open_recording
from altd.records import Frame, Spot
from altd.vision.flat import Flat
from altd.vision.localise import locate

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
class Unit:
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


def unit_of(seed: int, noise: int = 1) -> Unit:
    return Unit(surface(seed), np.random.default_rng(noise))


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Recording:
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


def test_the_response_comes_out_of_spots_that_overlap(scan: Recording, laser_flat: Recording) -> None:
    """A pixel has noise; what displaces a spot are differences over its size, of which little is left."""
    flat = flats_of(laser_flat, target_frames([scan]))["rear"]
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
    tmp_path: Path, scan: Recording, laser_flat: Recording
) -> None:
    """A lamp that shows the grain of the surface only in part, since it shines from all sides."""
    lit = np.clip(BLACK + 120 * (0.5 * surface(1) + 0.5 * surface(7)), 0, 255)
    lamp = Unit(surface(1), np.random.default_rng(6)).record(tmp_path / "lamp", "flat", [None] * 3)
    for n in range(3):
        cv2.imwrite(str(lamp.path / "rear" / f"{n}.png"), np.rint(lit).astype(np.uint8))
    without, by_lamp, by_laser = (errors_mm(scan, flat) for flat in (None, lamp, laser_flat))
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
    tmp_path: Path, scan: Recording, unit: Unit, places: list[Place], complaint: str
) -> None:
    flat = unit.record(tmp_path / "flat", "flat", places)
    with pytest.raises(BadInputError, match=complaint) as caught:
        flats_of(flat, target_frames([scan]))
    assert "\n" not in str(caught.value)


def test_one_of_another_unit_is_refused(tmp_path: Path, scan: Recording) -> None:
    flat = unit_of(1).record(tmp_path / "flat", "flat", raster(20.0), "TEST-2")
    with pytest.raises(BadInputError, match=r"is a flat of unit 'TEST-2', the scan is of unit 'TEST-1'"):
        flats_of(flat, target_frames([scan]))
