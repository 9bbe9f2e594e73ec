"""Drawn units are calibrated and verified as by a technician: right ones, and with one of three faults.

Frames are those of ``support.optics``. The errors of stages, beams, seats, wedge and stated distance are
drawn from the limits of ``benchmarks.verification``; altd receives the limits alone.

    PYTHONPATH=tests python -m support.verified_unit --units 20
"""

import argparse
import itertools
import math
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np

from altd.calibration import calibrating
from altd.calibration.file import load_calibration, save_calibration
from altd.calibration.result import TargetsResult
from benchmarks.verification import (
    CALIBRATION_LIMITS,
    DEFLECTION_DEG,
    DEFLECTION_SIGMA_DEG,
    REFERENCE_LIMITS,
    SEAT_MM_PER_M,
    Stage,
)
from support import optics
from support.cli import altd_here
from support.optics import DISTANCE_MM, FPS, Array, Beam, Row, Scene, Unit
from support.recordings import grid

CAMERAS = ("front", "rear")
MM_PER_PX = 0.006 * 256.0 / 5.7
"""Of the rear camera of ``optics``, in the middle of its plate."""
MOVED_PX, ASKEW_MM_PER_M, WRONG_MM = 0.5, 0.8, 1.0
ONE_SCAN_LIMITS = replace(CALIBRATION_LIMITS, beam_normal_mm_per_m=0.3)
SCANNED_MM = np.array(grid(6, 5))
CHECKED_MM = np.array(grid(5, 4, 26.0))
"""Both spots stay within the scan when a wedge turns the beam about the middle between the targets."""


class By(StrEnum):
    """Way of calibrating the unit."""

    TURNED = "calibrated with the unit turned"
    ONE_SCAN = "calibrated by one scan"


class Fault(StrEnum):
    """Error of the unit."""

    NONE = "without an error"
    CAMERA = "rear camera moved by 0.5 px"
    SEAT = "seated 0.8 mrad askew"
    DISTANCE = "distance stated as 281 mm"


ZERO_DEG = {
    Fault.CAMERA: -math.degrees(MOVED_PX * MM_PER_PX / DISTANCE_MM),
    Fault.SEAT: math.degrees(1e-3 * ASKEW_MM_PER_M / 2),
}
"""Error of the zero of yaw by a fault: one of both seatings is askew, and the zero is their mean."""
Document = Mapping[str, Any]
"""Output of ``altd verify --json``."""


@dataclass(frozen=True)
class _Mounting:
    """The unit before a stage.

    ``seat`` is the change of the beam's slopes (2,) by the unit's seating, in the unit's axes, ``offset_mm``
    (2,) the beam's place where the stage is at 0, 0, and ``deflection_deg`` (2,) what a wedge does to the
    beam, in the stage's axes.
    """

    turned: bool
    seat: Array
    turn_rad: float = 0.0
    offset_mm: Sequence[float] = (0.0, 0.0)
    deflection_deg: Sequence[float] = (0.0, 0.0)

    def beams(self, stage: Stage, known_mm: Array, rng: np.random.Generator) -> list[Beam]:
        """The beams in the unit's axes while the stage says that it is at these places (n, 2)."""
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        mounted = (-1.0 if self.turned else 1.0) * np.array([[cos, -sin], [sin, cos]])
        deflected = np.tan(np.arctan(stage.slope) + np.radians(self.deflection_deg))
        slopes = mounted @ deflected + self.seat
        places_mm = stage.places_mm(known_mm, rng) @ mounted.T + self.offset_mm
        return [Beam(*place, *slopes) for place in places_mm]


def _rows(unit: Unit, beams: Sequence[Beam], known_mm: Array, stream: int, exposures: int) -> Iterator[Row]:
    for number in range(exposures * len(beams)):
        beam, at = beams[number // exposures], tuple(known_mm[number // exposures])
        for name in CAMERAS:
            yield number / FPS, name, _picture(unit, name, beam, stream, number), at


def _picture(unit: Unit, name: str, beam: Beam, stream: int, number: int) -> Array:
    """The noise depends on the picture's own number alone, so a fault changes nothing else."""
    rng = np.random.default_rng([unit.seed, stream, number, name == "rear"])
    return unit.frame(name, beam, Scene(), number / FPS, rng)


def _seen_by(moved: Unit, rows: Sequence[Row], beams: Sequence[Beam], stream: int) -> Iterator[Row]:
    """The rows of one exposure a beam, those of the rear camera drawn again."""
    for row, (t_s, name, picture, at) in enumerate(rows):
        number = row // len(CAMERAS)
        if name == "rear":
            yield t_s, name, _picture(moved, name, beams[number], stream, number), at
        else:
            yield t_s, name, picture, at


def _middle_mm(unit: Unit) -> Array:
    """The middle (2,) of what both cameras see: spots at the end of a picture are known worse."""
    views = [unit.camera(name) for name in CAMERAS]
    high, low = min(view.y_mm[0].min() for view in views), max(view.y_mm[-1].max() for view in views)
    return np.array([0.0, np.rint((high + low) / 2)])


def _header(mounting: _Mounting) -> dict[str, object]:
    """Statements of a technician on a set: the wedge's nominal deflection, and limits."""
    stated: dict[str, object] = {"limits": asdict(REFERENCE_LIMITS), "seat_mm_per_m": SEAT_MM_PER_M}
    if any(mounting.deflection_deg):
        yaw_deg, pitch_deg = DEFLECTION_DEG
        stated |= {"deflection_yaw_deg": yaw_deg, "deflection_pitch_deg": pitch_deg}
        stated |= {"deflection_sigma_deg": DEFLECTION_SIGMA_DEG}
    return stated | {"turned_deg": 180 * mounting.turned}


class NotCalibratedError(Exception):
    """``altd calibrate`` refused the scans."""


class DrawnUnit:
    """A unit of a seed, its calibrations and the sets of its verification, written into a folder."""

    def __init__(self, seed: int, folder: Path) -> None:
        self._folder, self._unit = folder, Unit(seed)
        self._middle_mm = _middle_mm(self._unit)
        self._rng = np.random.default_rng([seed, 25])
        self._stated_mm = DISTANCE_MM + self._rng.normal(0, ONE_SCAN_LIMITS.target_distance_mm)
        self._calibrate()
        self._record_sets()

    def verified(self, by: By, fault: Fault) -> Document:
        """The verification by ``altd verify``."""
        calibration = self._calibration(by, self._stated_mm + WRONG_MM * (fault is Fault.DISTANCE))
        said = altd_here("verify", *self._sets[fault], "--calibration", calibration, "--json")
        assert said.status in (0, 1), said.err
        document: Document = said.objects[0]
        return document

    def _calibrate(self) -> None:
        """Scan the unit and the turned unit, by one stage, and calibrate it by one and by both scans."""
        stage, seats = Stage.made(ONE_SCAN_LIMITS, self._rng), self._seats()
        scans = []
        for turned, seat in zip((False, True), seats, strict=True):
            turn_rad, offset_mm = self._rng.normal(0, 1e-3), self._rng.normal(0, 0.5, 2)
            mounting = _Mounting(True, seat, turn_rad, offset_mm) if turned else _Mounting(False, seat)
            known_mm = self._known_mm(SCANNED_MM, turned)
            beams = mounting.beams(stage, known_mm, self._rng)
            rows = _rows(self._unit, beams, known_mm, 1 + turned, 1 if turned else 2)
            about = {"limits": asdict(ONE_SCAN_LIMITS), "seat_mm_per_m": SEAT_MM_PER_M}
            scans.append(self._write(f"scan-{turned:d}", rows, turned_deg=180 * turned, **about))
        made: list[TargetsResult] = []
        fit = calibrating.calibrate_scans

        def fitted_once(*arguments: Any) -> TargetsResult:
            """Both calibrations have the maps of the first scan, which take most of the time."""
            made.extend([] if made else [fit(*arguments)])
            return made[0]

        with mock.patch.object(calibrating, "calibrate_scans", fitted_once):
            for by, used in ((By.TURNED, scans), (By.ONE_SCAN, scans[:1])):
                said = altd_here("calibrate", *used, "-o", self._calibration(by, self._stated_mm))
                if said.status:
                    raise NotCalibratedError(said.err.strip())
        for by in By:  # the stated distance changes no map
            right = load_calibration(self._calibration(by, self._stated_mm))
            front, rear = right.targets
            wrong_mm = self._stated_mm + WRONG_MM
            wrong = replace(right, targets=(front, replace(rear, z_mm=wrong_mm)))
            save_calibration(wrong, self._calibration(by, wrong_mm))

    def _calibration(self, by: By, distance_mm: float) -> Path:
        return self._folder / f"{by.name}-{distance_mm:.3f}.json"

    def _record_sets(self) -> None:
        """Record the beam as it is and deflected, then the turned unit; another stage carries the beam."""
        stage, (seat, turned_seat) = Stage.made(REFERENCE_LIMITS, self._rng), self._seats()
        turn_rad = self._rng.normal(0, 2e-3)
        wedge_deg = self._rng.normal(DEFLECTION_DEG, DEFLECTION_SIGMA_DEG)
        offsets_mm = self._rng.normal(0, 0.5, (3, 2))
        offsets_mm[1] -= DISTANCE_MM / 2 * np.tan(np.radians(wedge_deg))
        mountings = (
            _Mounting(False, seat, turn_rad, offsets_mm[0]),
            _Mounting(False, seat, turn_rad, offsets_mm[1], wedge_deg),
            _Mounting(True, turned_seat, turn_rad, offsets_mm[2]),
        )
        # the view of a shared front camera is the same; it takes seconds to draw
        front = {"front": self._unit.camera("front")}
        moved = replace(self._unit, rear_shift_mm=(MOVED_PX * MM_PER_PX, 0.0), _cameras=front)
        sets: dict[Fault, list[Path]] = defaultdict(list)
        for number, mounting in enumerate(mountings):
            stream, about = 3 + number, _header(mounting)
            known_mm = self._known_mm(CHECKED_MM, mounting.turned)
            beams = mounting.beams(stage, known_mm, self._rng)
            rows = list(_rows(self._unit, beams, known_mm, stream, 1))
            right = self._write(f"set-{number}", rows, **about)
            of_moved = self._write(f"moved-{number}", _seen_by(moved, rows, beams, stream), **about)
            of_askew = right
            if mounting.turned:  # dirt under a button: the first seating was clean
                askew = [beam.moved((0.0, 0.0, 1e-3 * ASKEW_MM_PER_M, 0.0)) for beam in beams]
                of_askew = self._write("askew", _rows(self._unit, askew, known_mm, stream, 1), **about)
            for fault in Fault:
                sets[fault].append({Fault.CAMERA: of_moved, Fault.SEAT: of_askew}.get(fault, right))
        self._sets = sets

    def _known_mm(self, places_mm: Array, turned: bool) -> Array:
        """The stage's places (n, 2) about the middle of what the cameras see, also of the turned unit."""
        known_mm: Array = places_mm + (-self._middle_mm if turned else self._middle_mm)
        return known_mm

    def _seats(self) -> Array:
        seats: Array = self._rng.normal(0, 1e-3 * SEAT_MM_PER_M, (2, 2))
        return seats

    def _write(self, name: str, rows: Iterable[Row], **about: object) -> Path:
        unit = {"serial": f"OPTICS-{self._unit.seed}", "target_distance_mm": self._stated_mm}
        return optics.write(self._folder / name, "scan", rows, exposure_ms=10.0, unit=unit, **about)


def found_in(document: Document, key: str) -> Mapping[str, Any]:
    """The test of a verification by its key."""
    return next(test for test in document["tests"] if test["key"] == key)


_DETECTS = {"zero_yaw_deg": "zero of yaw, °", "scale_pitch_ppm": "scale of pitch, ppm"}
_DETECTS |= {"target_distance_mm": "distance of the targets, mm"}


def main(arguments: list[str] | None = None) -> int:
    """Verify so many units, without an error and with each fault; print all verdicts, then their counts."""
    parser = argparse.ArgumentParser(prog="support.verified_unit")
    parser.add_argument("--units", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1, help="of the first unit")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    counts: dict[tuple[By, Fault], Counter[str]] = defaultdict(Counter)
    reasons: dict[tuple[By, Fault], Counter[str]] = defaultdict(Counter)
    detects: dict[tuple[By, str], list[float]] = defaultdict(list)
    refused = 0
    for seed in range(options.seed, options.seed + options.units):
        with tempfile.TemporaryDirectory() as folder:
            try:
                unit = DrawnUnit(seed, Path(folder))
            except NotCalibratedError as error:
                print(f"{seed}, not calibrated: {error}", flush=True)
                refused += 1
                continue
            for by, fault in itertools.product(By, Fault):
                document = unit.verified(by, fault)
                counts[by, fault][document["verdict"]] += 1
                reasons[by, fault].update(reason.split(":")[0] for reason in document["reasons"])
                zero, distance = (found_in(document, key) for key in ("zero_yaw_deg", "target_distance_mm"))
                found = f"zero of yaw {zero['value']:.4f}°, distance {distance['value']:.3f} mm"
                said = "; ".join((document["verdict"], found, *document["reasons"]))
                print(f"{seed}, {by}, {fault}: {said}", flush=True)
                for key in _DETECTS if fault is Fault.NONE else ():
                    detects[by, key].append(found_in(document, key)["detectable"])
    print(f"units: {options.units}, not calibrated: {refused}")
    for (by, fault), verdicts in counts.items():
        print(f"{by}, {fault}: {_counted(verdicts)}; reasons: {_counted(reasons[by, fault])}")
    for (by, key), errors in detects.items():
        low, middle, high = np.quantile(errors, (0.0, 0.5, 1.0))
        print(f"{by}, {_DETECTS[key]}: detects {middle:.4g} in the median, {low:.4g} to {high:.4g}")
    return 0


def _counted(things: Counter[str]) -> str:
    return ", ".join(f"{count} {thing}" for thing, count in things.items()) or "none"


if __name__ == "__main__":
    sys.exit(main())
