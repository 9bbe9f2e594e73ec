"""The calibration that the chains of this room measure by."""

import pytest
from support.played_unit import PlayedUnit

from altd.calibration.file import load_calibration
from altd.measuring.calibration import Calibration


@pytest.fixture(scope="module")
def calibration(played_unit: PlayedUnit) -> Calibration:
    return load_calibration(played_unit.calibration)
