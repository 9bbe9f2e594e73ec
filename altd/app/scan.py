"""``altd scan``: the cameras and the stage of a config, composed for a calibration scan."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from altd.acquisition.frame_sets import FrameSets
from altd.acquisition.scan.leds import KnownUnit, ScanLeds
from altd.acquisition.scan.scanner import Scanner, Teller
from altd.acquisition.self_check.judging import CheckJudge, limits_of
from altd.app.parts import calibration_of, cameras_of, exposure_controls_of, lamps_of, stage_of
from altd.app.self_check import why_unchecked
from altd.config import Config
from altd.errors import BadInputError
from altd.measuring.chain import View
from altd.ports import Camera, Lamps
from altd.runtime.clock import SystemClock
from altd.status.health import Health


def scanner_of(
    config: Config,
    place: Path,
    folder: Path,
    teller: Teller,
    cameras: Mapping[str, Camera] | None = None,
    lamps: Lamps | None = None,
) -> Scanner:
    """The scan into ``folder`` that a config describes; raises BadInputError.

    ``cameras`` and ``lamps`` stand in for those of the config.
    """
    stage = stage_of(config, place)
    cameras = cameras_of(config, place) if cameras is None else cameras
    lamps = lamps_of(config, cameras, place) if lamps is None else lamps
    exposure = exposure_controls_of(config)
    sets = FrameSets(list(cameras.values()), config.measuring, Health(SystemClock()), exposure)
    leds = None if lamps is None else ScanLeds(lamps, known_unit_of(config, cameras))
    return Scanner(config, folder, sets, stage, leds, teller)


def known_unit_of(config: Config, cameras: Mapping[str, Camera]) -> KnownUnit | str:
    """The unit as the config's calibration knows it, for a unit with frame LEDs; or why it is not known."""
    if not os.path.lexists(config.unit.calibration):
        return "there is no calibration yet; the LED pairs of this scan will be its references"
    try:
        calibration = calibration_of(config, cameras)
    except BadInputError as error:
        return str(error)
    if why := why_unchecked(calibration, cameras, has_lamps=True):
        return why
    return KnownUnit(
        calibration,
        CheckJudge(
            [View(target.name, target.camera) for target in config.targets],
            calibration,
            limits_of(config.self_check),
            config.installation,
        ),
        {target.camera: target.name for target in config.targets},
    )
