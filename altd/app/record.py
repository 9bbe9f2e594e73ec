"""``altd record``: the cameras of a config, recorded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from altd.acquisition.exposures_writer import RecordingPlan
from altd.acquisition.frame_sets import FrameSets
from altd.acquisition.record import record
from altd.app.parts import cameras_of, exposure_controls_of, lamps_of
from altd.config import Config, LiveCameraSettings
from altd.errors import BadInputError
from altd.recording.header import Kind, target_headers, unit_header
from altd.recording.writer import refuse_used_folder
from altd.runtime.clock import SystemClock
from altd.status.health import Health


async def record_of(
    config: Config,
    place: Path,
    folder: Path,
    seconds: float,
    kind: Kind,
    progress: Callable[[int, int], None] = lambda done, planned: None,
) -> int:
    """Record from the config's cameras into ``folder``; returns the number of exposures.

    ``progress`` is told after each of them how many of how many there are. For a self-check the frame LEDs
    are switched off and on in turn; BadInputError where live cameras have none. Raises LampsError and
    CameraError when they fail meanwhile.
    """
    refuse_used_folder(folder)
    cameras = cameras_of(config, place)
    lamps = lamps_of(config, cameras, place) if kind == "self-check" else None
    is_live = any(isinstance(camera, LiveCameraSettings) for camera in config.cameras.values())
    if kind == "self-check" and lamps is None and is_live:
        raise BadInputError(place, "no [lamps] table: the frame LEDs of a self-check cannot be switched")
    exposure = exposure_controls_of(config)
    sets = FrameSets(list(cameras.values()), config.measuring, Health(SystemClock()), exposure)
    unit, targets = unit_header(config.unit.serial, config.targets), target_headers(config.targets)
    return await record(sets, folder, RecordingPlan(seconds, unit, targets, kind), progress, lamps)
