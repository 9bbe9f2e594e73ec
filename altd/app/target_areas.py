"""The area of each target in which a spot is valid, from the calibration."""

from __future__ import annotations

from altd.config import Config
from altd.measuring.calibration import Calibration
from altd.status.target_area import TargetArea


def target_areas_of(config: Config, calibration: Calibration) -> tuple[TargetArea, ...]:
    """The targets of the config, in beam order."""
    known = [(target, calibration.target(target.name)) for target in config.targets]
    return tuple(
        TargetArea(target.name, target.z_mm, tuple((x, y) for x, y in fitted.valid_mm.tolist()))
        for target, fitted in known
        if fitted is not None
    )
