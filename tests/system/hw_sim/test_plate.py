"""Whole plates before simulated cameras."""

from pathlib import Path

import numpy as np
import pytest

from altd.recording.reader import open_recording
from hw_sim.__main__ import main
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


def test_the_command_line_records_a_plate(tmp_path: Path) -> None:
    assert (
        main(["plate", "-o", str(tmp_path / "p"), "--seed", "4", "--exposures", "1", "--dark", "0,0", "6,4"])
        == 0
    )
    assert open_recording(tmp_path / "p").header.unit.serial == "SIM-4"
