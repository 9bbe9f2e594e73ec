"""``python -m benchmarks.area`` (``make bench-area``): beams anywhere on the 140 × 110 mm of both targets.

Simulated units are scanned, calibrated and measured; each measurement is compared with the true beam. The
scan covers the specified area, or 125 × 100 mm as in Fig. 3.24: positions outside its nodes are then measured
in the margin of the maps. ``tight`` cameras have pictures that end 4 mm beside the area, so that spots at its
edge are cut. ``hard`` has all effects of ``hw_sim.hardness``, ``no laser speckle`` all except the laser's own
speckle; their flats are made with a lamp.
"""

import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from altd.calibration.calibrating import calibrate
from altd.config import Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.recording.reader import open_recording
from altd.records import Measurement
from benchmarks.harness import KEYS, Columns, Parser, end, quiet
from hw_sim.assembly import FIELD_HALF_MM
from hw_sim.beam import BeamPose, Laser
from hw_sim.flat import RASTER_PITCH_MM, record_flat, record_laser_flat
from hw_sim.hardness import HARD, Hardness
from hw_sim.measure import HALF_AREA_MM, random_poses
from hw_sim.scan import STAGE_STREAM, USUAL, Grid, record_scan
from hw_sim.stage import ADJUSTED, MISALIGNED, Mounting, Stage
from hw_sim.targets import DotPattern
from hw_sim.unit import CAMERAS, EXPOSURES_MS, Unit, UnitConfig

TIGHT_HALF_MM = (74.0, 59.0)
NARROW_PITCH_MM = 25.0
OUTER_MM = 10.0
WINDOW = 4
FLAT_EXPOSURES = 10
FLAT_SHARE = 0.6
POSES_STREAM = 11
COVERAGE_FACTOR = 2.0
"""Coverage factor of the expanded uncertainty, for 95 %."""


@dataclass(frozen=True, slots=True)
class Case:
    """Construction and scans of the units."""

    name: str
    flat: bool = False
    pitch_mm: float = USUAL.pitch_mm
    field_half_mm: tuple[float, float] = FIELD_HALF_MM
    speckle_contrast: float = 0.16
    print_mm: tuple[float, float] | None = None
    mounting: Mounting = ADJUSTED
    with_turned_scan: bool = False
    laser_flat: bool = False
    hard: Hardness | None = None
    laser: Laser = field(default_factory=Laser)


STILL = replace(HARD, speckle_contrast=0.0)

CASES = (
    Case("plain"),
    Case("flat", flat=True),
    Case("no speckle", speckle_contrast=0.0),
    Case("no speckle, flat", flat=True, speckle_contrast=0.0),
    Case("coarse", speckle_contrast=0.2),
    Case("coarse, flat", flat=True, speckle_contrast=0.2),
    Case("narrow", pitch_mm=NARROW_PITCH_MM),
    Case("print ends, flat", flat=True, print_mm=(146.0, 116.0)),
    Case("tight", field_half_mm=TIGHT_HALF_MM),
    Case("tight, flat", flat=True, field_half_mm=TIGHT_HALF_MM),
    Case("misaligned", mounting=MISALIGNED),
    Case("misaligned, turned", mounting=MISALIGNED, with_turned_scan=True),
    Case("no laser speckle", hard=STILL),
    Case("no laser speckle, flat", flat=True, hard=STILL),
    Case("hard", hard=HARD),
    Case("hard, flat", flat=True, hard=HARD),
    Case("laser flat", laser_flat=True),
    Case("hard, laser flat", laser_flat=True, hard=HARD),
    Case("hard, 15 mm", hard=HARD, laser=Laser(3.0, (15.0, 15.0))),
    Case("hard, 13 x 5 mm", hard=HARD, laser=Laser(1.5, (13.0, 5.0))),
)


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Errors and sigmas of a beam: x mm, y mm, yaw °, pitch °; NaN where it is not measured."""

    is_outer: bool
    errors: npt.NDArray[np.float64]
    sigma: npt.NDArray[np.float64]
    reasons: tuple[str, ...]

    @property
    def is_valid(self) -> bool:
        """Whether there is a measurement."""
        return not self.reasons


def measured(case: Case, seed: int, beams: int, folder: Path) -> list[Comparison]:
    """Measure the beams of one unit, after its calibration."""
    of_unit = UnitConfig(
        seed=seed,
        field_half_mm=case.field_half_mm,
        speckle_contrast=case.speckle_contrast,
        dots=DotPattern(size_mm=case.print_mm),
        hard=case.hard,
        laser=case.laser,
    )
    unit = Unit(of_unit)
    calibration, measuring = _calibrated(case, unit, folder), Measuring(window=WINDOW, every=WINDOW)
    views, instrument = [View(name, name) for name in CAMERAS], BeamInstrument(calibration, measuring)
    chain = MeasuringChain(views, calibration, measuring, instrument)
    poses = random_poses(beams, unit.config.target_distance_mm, np.random.default_rng([seed, POSES_STREAM]))
    held = []
    for number, pose in enumerate(poses):
        unit.place(pose)
        for sequence in range(number * WINDOW, (number + 1) * WINDOW):
            for camera in CAMERAS:
                frame = unit.expose(camera, sequence, sequence * unit.config.period_ns)
                held += [_compared(of, pose, unit.config.target_distance_mm) for of in chain.push(frame)]
    return held


def _calibrated(case: Case, unit: Unit, folder: Path) -> Calibration:
    if case.flat:
        record_flat(folder / "flat", unit, FLAT_EXPOSURES, quiet)
    scans = [folder / "scan", folder / "turned"][: 2 if case.with_turned_scan else 1]
    for is_turned, scan in enumerate(scans):
        rng = np.random.default_rng([unit.config.seed, STAGE_STREAM + is_turned])
        stage = Stage(rng, mounting=replace(case.mounting, is_turned=bool(is_turned)))
        record_scan(scan, unit, stage, 2, quiet, Grid(case.pitch_mm))
    if case.laser_flat:
        stage = Stage(np.random.default_rng([unit.config.seed, STAGE_STREAM + 2]), mounting=case.mounting)
        for name in CAMERAS:  # speckle saturates pixels at the exposure time of a measurement
            unit.set_camera(name, exposure_ms=FLAT_SHARE * EXPOSURES_MS[name])
        record_laser_flat(folder / "flat", unit, stage, RASTER_PITCH_MM, FLAT_EXPOSURES, quiet)
        for name in CAMERAS:
            unit.set_camera(name, exposure_ms=EXPOSURES_MS[name])
    flat = open_recording(folder / "flat") if case.flat or case.laser_flat else None
    unit.leds_on = False
    unit.even_mw_per_mm2 = 0.0
    return calibrate([open_recording(scan) for scan in scans], flat, quiet).calibration


def _compared(measurement: Measurement, pose: BeamPose, distance_mm: float) -> Comparison:
    spots = np.abs([pose.at(0.0), pose.at(distance_mm)])
    is_outer = bool(np.any(spots > np.array(HALF_AREA_MM) - OUTER_MM))
    if not measurement.valid:
        unknown = np.full(4, np.nan)
        return Comparison(is_outer, unknown, unknown, tuple(map(str, measurement.status)))
    values = [measurement.values[key] for key in KEYS]
    errors = np.array([value.value - getattr(pose, key) for key, value in zip(KEYS, values, strict=True)])
    sigma = np.array([value.sigma for value in values], dtype=np.float64)
    return Comparison(is_outer, errors, sigma, ())


_TABLE = Columns(
    *(":<24", "beams:>6", "  valid:>9.1%", "   x mm:>9.4f", " y mm:>7.4f", "  yaw:>8.4f", "pitch °:>8.4f"),
    *("   x:>7.2f", "y:>6.2f", "yaw:>6.2f", "pitch:>6.2f", "all:>7.2f", "worst:>6.1f", "mm:>8.3f"),
    f"in {COVERAGE_FACTOR:g} sigma:>11.1%",
)


def row(name: str, beams: Sequence[Comparison]) -> str:
    """Figures of a group of beams, as a line of the table."""
    valid = [beam for beam in beams if beam.is_valid]
    if not valid:
        return _TABLE.row(name, len(beams), 0.0)
    errors = np.array([beam.errors for beam in valid])
    normalised = errors / np.array([beam.sigma for beam in valid])
    return _TABLE.row(
        *(name, len(beams), len(valid) / len(beams)),
        *np.sqrt(np.mean(np.square(errors), axis=0)),
        *np.sqrt(np.mean(np.square(normalised), axis=0)),
        *(np.sqrt(np.mean(np.square(normalised))), np.abs(normalised).max(), np.abs(errors[:, :2]).max()),
        np.mean(np.abs(normalised) <= COVERAGE_FACTOR),
    )


def reasons(beams: Iterable[Comparison]) -> str:
    """Reasons of the invalid measurements, with their numbers."""
    counted = Counter(reason for beam in beams for reason in beam.reasons)
    return ", ".join(f"{reason} {count}" for reason, count in counted.most_common()) or "none"


def main(arguments: list[str] | None = None) -> int:
    """Measure and print."""
    parser = Parser("benchmarks.area", __doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5, 6], help="which units")
    parser.count("--beams", 100, "beams a unit")
    names = [case.name for case in CASES]
    parser.add_argument("--cases", nargs="+", default=names, choices=names, help="which cases")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    print("rms error, rms of error/sigma, worst error in sigmas and in mm, share within so many sigma")
    print(_TABLE.head)
    for case in CASES:
        if case.name not in options.cases:
            continue
        held: list[Comparison] = []
        for seed in options.seeds:
            with tempfile.TemporaryDirectory() as folder:
                held += measured(case, seed, options.beams, Path(folder))
        print(row(case.name, held))
        print(row("  outer 10 mm", [beam for beam in held if beam.is_outer]))
        print(f"  not measured: {reasons(held)}", flush=True)
    return 0


if __name__ == "__main__":
    end(main, "benchmarks.area")
