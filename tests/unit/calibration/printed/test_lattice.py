"""Prints of known pitch and lattice before the simulator's camera."""

from __future__ import annotations

import numpy as np
import pytest
from support.prints import Scene, lattice_of, steps

from altd.calibration.printed.lattice import Lattice


@pytest.mark.parametrize("speckle", [0.0, 0.16, 0.6])
def test_a_plain_target_has_none_however_coarse_its_grain(speckle: float) -> None:
    assert lattice_of(Scene(None, speckle, power_mw=2.0)) is None


@pytest.mark.parametrize("angle_deg", [60.0, 120.0, 90.0])
def test_the_harmonics_are_all_waves_within_a_circle(angle_deg: float) -> None:
    """A hexagonal lattice has 45 pairs of points around the middle out to its fifth ring."""
    lattice = Lattice(steps(7.0, angle_deg, 10.0))
    lengths = np.hypot(*lattice.vectors.T)
    if angle_deg != 90.0:
        assert len(lattice.harmonics) == 45
        assert lengths.max() == pytest.approx(5 * 7.0)
    assert np.sum(np.isclose(lengths, lengths.min())) == (2 if angle_deg == 90.0 else 3)
    rng = np.random.default_rng(1)
    mm = rng.uniform(-60, 60, (20, 2))
    assert lattice.waves(mm) == pytest.approx(np.exp(1j * mm @ lattice.vectors.T), abs=1e-9)
