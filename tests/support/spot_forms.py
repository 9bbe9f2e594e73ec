"""Beams of other forms on a unit that is drawn from the optics: share valid, errors and reasons.

Calibrated with the ordinary beam, and with the beam that is measured.

    PYTHONPATH=tests python -m support.spot_forms --beams 100
"""

import argparse
import math
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from altd.calibration.calibrating import calibrate
from altd.config import Measuring
from altd.measuring.calibration import Calibration
from altd.recording.reader import open_recording
from altd.records import Frame, Measurement
from support.measurements import beam_chain
from support.optics import FPS, Array, Beam, Unit, poses, random_beams, scan, write

KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
ORDINARY = "12 x 11 mm"
RADII_MM = {ORDINARY: (6.0, 5.5), "13 x 5 mm": (6.5, 2.5), "15 mm": (7.5, 7.5)}
EXPOSURES = 4


def calibrated(unit: Unit, radius_mm: tuple[float, float]) -> Calibration:
    """The calibration of a unit by a scan with that beam."""
    with TemporaryDirectory() as folder:
        rows = scan(unit, unit.seed, Beam(radius_mm=radius_mm))
        recording = open_recording(write(Path(folder) / "scan", "scan", rows, exposure_ms=10.0))
        return calibrate([recording]).calibration


def measured(
    calibrations: Sequence[Calibration], unit: Unit, beams: Sequence[Beam]
) -> list[list[Measurement]]:
    """A measurement of each beam with each calibration, of the same frames."""
    measuring = Measuring(window=EXPOSURES, every=EXPOSURES)
    chains = [beam_chain(calibration, measuring) for calibration in calibrations]
    found: list[list[Measurement]] = [[] for _ in chains]
    for t_s, camera, pixels, _ in poses(unit, beams, seed=unit.seed, exposures=EXPOSURES):
        pixels.flags.writeable = False
        frame = Frame(camera, round(t_s * FPS), round((1 + t_s) * 1e9), pixels, exposure_ms=10.0)
        for chain, of in zip(chains, found, strict=True):
            of += chain.push(frame)
    return found


def compared(measurement: Measurement, beam: Beam) -> tuple[Array, Array]:
    """Errors (4,) and sigmas (4,) of a valid measurement: x, y in mm, yaw, pitch in degrees."""
    slopes_deg = map(math.degrees, map(math.atan, (beam.slope_x, beam.slope_y)))
    values = [measurement.values[key] for key in KEYS]
    truth = (beam.x, beam.y, *slopes_deg)
    return np.array([v.value - t for v, t in zip(values, truth, strict=True)]), np.array(
        [v.sigma for v in values], dtype=np.float64
    )


def main(arguments: list[str] | None = None) -> int:
    """Measure so many beams of each form, on each unit; print each refusal, then a line for each case."""
    parser = argparse.ArgumentParser(prog="support.spot_forms")
    parser.add_argument("--beams", type=int, default=100, help="of each form on each unit")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="which units")
    parser.add_argument("--forms", nargs="+", choices=RADII_MM, default=list(RADII_MM)[1:])
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    for seed in options.seeds:
        unit = Unit(seed)
        calibrations = {name: calibrated(unit, RADII_MM[name]) for name in {ORDINARY, *options.forms}}
        for form in options.forms:
            beams = random_beams(options.beams, seed, radius_mm=RADII_MM[form])
            by = [ORDINARY] if form == ORDINARY else [ORDINARY, form]
            for name, of in zip(by, measured([calibrations[name] for name in by], unit, beams), strict=True):
                _print(f"unit {seed}, {form}, calibrated with {name}", of, beams)
    return 0


def _print(case: str, measurements: Sequence[Measurement], beams: Sequence[Beam]) -> None:
    refused: Counter[str] = Counter()
    pairs = list[tuple[Array, Array]]()
    for measurement, beam in zip(measurements, beams, strict=True):
        if measurement.valid:
            pairs.append(compared(measurement, beam))
            continue
        why = "; ".join(f"{fault} {fault.detail}" for fault in measurement.status)
        at = f"x {beam.x:.0f} y {beam.y:.0f} mm, slopes {beam.slope_x:.3f} {beam.slope_y:.3f}"
        print(f"{case}: refused at {at}: {why}")
        refused.update(str(fault) for fault in measurement.status)
    if not pairs:
        print(f"{case}: 0 of {len(beams)} valid; {dict(refused)}", flush=True)
        return
    errors, sigmas = (np.array(of) for of in zip(*pairs, strict=True))
    ratio = errors / sigmas
    rms, of_sigma = (np.sqrt(np.mean(np.square(of), axis=0)) for of in (errors, ratio))
    print(
        f"{case}: {len(pairs)} of {len(beams)} valid; rms {rms[0]:.4f} {rms[1]:.4f} mm {rms[2]:.5f} "
        f"{rms[3]:.5f} deg; rms of error/sigma {np.round(of_sigma, 2)}, largest {np.abs(ratio).max():.1f}; "
        f"largest error {np.abs(errors[:, :2]).max():.3f} mm {np.abs(errors[:, 2:]).max():.4f} deg; "
        f"{dict(refused)}",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
