"""A print that ends within spots, of beams that are symmetric or not: drawn from the optics alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import optics
from support.measurements import beam_chain

from altd.calibration.calibrating import calibrate
from altd.calibration.result import CalibrationResult
from altd.config import Measuring
from altd.errors import BadInputError
from altd.recording.reader import open_recording
from altd.records import Frame, Measurement

END_MM = 65.5
"""3 mm outside the outermost nodes, half the 1/e² radius of the spots."""
ONE_SIDE, ALL_SIDES = (-END_MM, 1e3, -1e3, 1e3), (-END_MM, END_MM, -53.0, 53.0)


def coma(along: np.ndarray, across: np.ndarray) -> np.ndarray:
    return np.exp(-2 * ((along + 0.12 * (along**2 + across**2)) ** 2 + across**2) ** 1.2)


SYMMETRIC, COMA = optics.Beam(), optics.Beam(field_of=coma)


def calibrated(folder: Path, unit: optics.Unit, beam: optics.Beam) -> CalibrationResult:
    scan = optics.write(folder / "scan", "scan", optics.scan(unit, beam=beam))
    flat = optics.write(folder / "flat", "flat", optics.lamp_flat(unit))
    return calibrate([open_recording(scan)], open_recording(flat))


def measured(made: CalibrationResult, unit: optics.Unit, beam: optics.Beam) -> Measurement:
    chain = beam_chain(made.calibration, Measuring(window=4, every=4))
    frames = (
        Frame(name, round(t_s * optics.FPS), round(t_s * 1e9), picture)
        for t_s, name, picture, _ in optics.poses(unit, [beam], exposures=4)
    )
    return [measurement for frame in frames for measurement in chain.push(frame)][-1]


def test_the_nodes_of_an_asymmetric_beam_at_the_end_of_the_print_are_refused(tmp_path: Path) -> None:
    """They are 0.3 to 0.4 mm off. The map of the others measures right up to its own end and beyond."""
    unit = optics.Unit(seed=3, print_mm=ONE_SIDE)
    made = calibrated(tmp_path, unit, COMA)
    assert len(made.refused) == 5
    assert all(
        line.startswith("front node x -62.5") and "print or surface ends within" in line
        for line in made.refused
    )
    for x_mm in (-49.0, 0.0):
        measurement = measured(made, unit, replace(COMA, x=x_mm, y=10.0))
        value = measurement.values["x_mm"]
        assert abs(value.value - x_mm) < min(4 * value.sigma, 0.1)
    assert made.calibration.targets[0].spot.misfit_ratio > 3, "the beam is asymmetric"


def test_a_symmetric_beam_is_measured_up_to_the_end_of_the_print_and_beyond(tmp_path: Path) -> None:
    """Through a flat, which it needs: without one the ends are refused."""
    unit = optics.Unit(seed=3, print_mm=ALL_SIDES)
    made = calibrated(tmp_path, unit, SYMMETRIC)
    assert made.refused == ()
    with pytest.raises(
        BadInputError, match=r"front: print or surface ends .* x -62.5, x 62.5, y -50, y 50 mm"
    ):
        calibrate([open_recording(tmp_path / "scan")])
    inside, outside = (measured(made, unit, replace(SYMMETRIC, x=x_mm, y=10.0)) for x_mm in (-40.0, -67.0))
    for measurement, x_mm in ((inside, -40.0), (outside, -67.0)):
        value = measurement.values["x_mm"]
        assert abs(value.value - x_mm) < 4 * value.sigma
    assert outside.values["x_mm"].sigma > 2 * inside.values["x_mm"].sigma
