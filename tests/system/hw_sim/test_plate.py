"""Whole plates before simulated cameras."""

import numpy as np
import pytest

from hw_sim.plate import Plate, with_plate
from hw_sim.unit import Unit, UnitConfig


@pytest.mark.parametrize("fisheye_lens", [False, True])
def test_tilted_cameras_see_all_of_the_plate(fisheye_lens: bool) -> None:
    plate = Plate(pitch_mm=25.0, tilt_deg=30.0, fisheye=fisheye_lens)
    unit = with_plate(Unit(UnitConfig(seed=2)), plate)
    for imager in unit.imagers.values():
        lens = imager.view.lens
        u, v = lens.project([-77.5, 77.5, 77.5, -77.5], [-52.5, -52.5, 52.5, 52.5])
        assert 0 < u.min() < u.max() < 751
        assert 0 < v.min() < v.max() < 479
        assert np.degrees(np.arccos(lens.rotation[2, 2])) == pytest.approx(30.0, abs=2.0)
