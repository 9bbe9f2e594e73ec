"""``altd scan``: the cameras and the stage of a config, composed for a calibration scan."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from altd.acquisition.scan.scanner import Scanner, Teller
from altd.app.parts import cameras_of, exposure_controls_of, lamps_of, stage_of
from altd.config import Config
from altd.ports import Camera, Lamps
from altd.runtime.clock import SystemClock


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
    clock, exposure = SystemClock(), exposure_controls_of(config)
    return Scanner(config, folder, list(cameras.values()), stage, lamps, clock, teller, exposure)
