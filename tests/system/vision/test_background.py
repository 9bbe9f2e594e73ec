"""The localiser on frames of simulated units without a spot."""

import pytest

from altd.reasons import Reason
from altd.records import NoSpot
from altd.vision.localise import locate
from hw_sim.faults import Fault
from hw_sim.unit import CAMERAS, Unit, UnitConfig


@pytest.mark.parametrize("lux", [0.0, 200.0, 1000.0])
def test_ambient_light_alone_is_no_spot(lux: float) -> None:
    for seed in (1, 3, 9, 12):
        unit = Unit(UnitConfig(seed=seed, lux=lux))
        unit.inject(Fault.NO_LASER)
        for camera in CAMERAS:
            outcome = locate(unit.expose(camera, 0, 0))
            assert isinstance(outcome, NoSpot)
            assert outcome.reason is Reason.SPOT_MISSING, (seed, camera, outcome)
