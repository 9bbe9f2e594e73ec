"""Prints of many lattices before a simulated camera."""

import numpy as np
import pytest
from support.prints import Dots, Scene, lattice_of, steps

from altd.calibration.printed.lattice import Lattice


def whole(lattice: Lattice, steps_mm: np.ndarray) -> np.ndarray:
    """The distance of the phases that a print's steps turn through from whole turns, radians."""
    turns = steps_mm @ lattice.reciprocal.T / (2 * np.pi)
    assert abs(np.linalg.det(turns)) == pytest.approx(
        1, abs=0.01
    )  # the lattice itself, no coarser or finer one
    return 2 * np.pi * np.abs(turns - np.rint(turns))


@pytest.mark.parametrize(
    ("pitch_mm", "angle_deg", "turn_deg", "ratio", "radius_mm"),
    [
        (0.8, 60, -1.9, 1.0, 0.20),
        (2.0, 60, 17.0, 1.0, 0.50),
        (1.0, 90, 0.5, 1.0, 0.25),
        (1.0, 90, 31.0, 1.7, 0.30),
    ],
)
def test_lattices_of_many_kinds_are_found(
    pitch_mm: float, angle_deg: float, turn_deg: float, ratio: float, radius_mm: float
) -> None:
    steps_mm = steps(pitch_mm, angle_deg, turn_deg, ratio)
    lattice = lattice_of(Scene(Dots(steps_mm, radius_mm), power_mw=2.5))
    assert lattice is not None
    assert lattice.pitch_mm == pytest.approx(pitch_mm, rel=1e-3)
    assert whole(lattice, steps_mm).max() < 0.003
