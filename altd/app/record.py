"""``altd record`` and ``altd scan``: composition of a config's cameras and stage for a recording."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from altd.acquisition.exposures_writer import RecordingPlan
from altd.acquisition.frame_sets import FrameSets
from altd.acquisition.glasses import glass_cycle
from altd.acquisition.lamps.controller import LampController
from altd.acquisition.record import record
from altd.acquisition.scan.leds import KnownUnit, ScanLeds
from altd.acquisition.scan.scanner import ProgressReporter, Scanner
from altd.acquisition.self_check.judging import CheckJudge, limits_of
from altd.app.parts import (
    calibration_of,
    cameras_of,
    exposure_controls_of,
    lamps_of,
    led_plate_of,
    switches_of,
)
from altd.app.self_check import fps_of, why_unchecked
from altd.config import Config, LiveCameraSettings
from altd.config.unit import target_headers, unit_header
from altd.errors import BadInputError
from altd.measuring.chain import View
from altd.ports import Camera, Lamps, LampsError, Switches
from altd.recording.header import Kind, LedPlateHeader, PlateHeader
from altd.recording.writer import refuse_used_folder
from altd.runtime.clock import SystemClock
from altd.status.health import Health


async def record_of(
    config: Config,
    place: Path,
    folder: Path,
    seconds: float,
    shows: Kind | PlateHeader | Mapping[str, float],
    progress: Callable[[int, int], None] = lambda done, planned: None,
) -> int:
    """Record from the config's cameras into ``folder``; return the number of exposures.

    ``progress`` receives the count and the total after each exposure. For a self-check the frame LEDs are
    switched off and on in turn; raises BadInputError if live cameras have none. Raises LampsError and
    CameraError on a failure while recording. ``shows`` is the kind; or the plate for kind ``plate``; or the
    known pose of the config's plate with LEDs, or the joints of its machine, by the columns of a recording.
    """
    refuse_used_folder(folder)
    plate, kind, stated = _shown(config, place, shows)
    cameras = cameras_of(config, place)
    lamps = lamps_of(config, cameras, place) if kind == "self-check" else None
    is_live = any(isinstance(camera, LiveCameraSettings) for camera in config.cameras.values())
    if kind == "self-check" and lamps is None and is_live:
        raise BadInputError(place, "no [lamps] table: the frame LEDs of a self-check cannot be switched")
    unit, targets = unit_header(config.unit.serial, config.targets), target_headers(config.targets)
    plan = RecordingPlan(seconds, unit, targets or None, kind, plate=plate, stated=stated)
    health, exposure = Health(SystemClock()), exposure_controls_of(config)
    switches = switches_of(config, cameras, place)
    if switches is None or kind != "measurement":
        sets = FrameSets(list(cameras.values()), config.measuring, health, exposure)
        return await record(sets, folder, plan, progress, lamps)
    controller = LampController(switches, switches.show, "", health.component("switches"), health.clock)
    cycle = glass_cycle(controller, config, fps_of(config), health.clock)
    sets = FrameSets(list(cameras.values()), config.measuring, health, exposure, [cycle.marks])
    switching = [
        asyncio.create_task(controller.run(health.component(f"camera {name}") for name in cameras)),
        asyncio.create_task(cycle.run()),
    ]
    try:
        exposures = await record(sets, folder, replace(plan, has_opaque=True), progress)
        if complaint := controller.last_failure or controller.complaint:
            raise LampsError(f"a glass could not be switched: {complaint}")
        return exposures
    finally:
        for task in switching[::-1]:
            task.cancel()
        await asyncio.gather(*switching, return_exceptions=True)


def _shown(
    config: Config, place: Path, shows: Kind | PlateHeader | Mapping[str, float]
) -> tuple[PlateHeader | LedPlateHeader | None, Kind, Mapping[str, float] | None]:
    """Return the plate, the kind of the recording, and the known pose or joints."""
    if config.unit.instrument != "planar":
        if isinstance(shows, Mapping):
            raise BadInputError(place, '--pose and --joints require instrument = "planar"')
        return (shows, "plate", None) if isinstance(shows, PlateHeader) else (None, shows, None)
    if isinstance(shows, PlateHeader) or shows in ("flat", "self-check"):
        raise BadInputError(
            place, 'instrument = "planar" is recorded with only --pose or --joints, or without a kind'
        )
    if (plate := led_plate_of(config)) is None:
        raise BadInputError(place, "no [plate] table: the places of the plate's LEDs are part of a recording")
    return plate, "planar", shows if isinstance(shows, Mapping) else None


def scanner_of(  # noqa: PLR0913  the parts of a scan
    config: Config,
    place: Path,
    folder: Path,
    progress: ProgressReporter,
    cameras: Mapping[str, Camera] | None = None,
    lamps: Lamps | None = None,
    switches: Switches | None = None,
) -> Scanner:
    """Return the scan of a config into ``folder``; raises BadInputError.

    ``cameras``, ``lamps`` and ``switches`` replace those of the config.
    """
    if config.stage is None:
        raise BadInputError(place, "stage: no [stage] table")
    stage = config.stage.stage()
    cameras = cameras_of(config, place) if cameras is None else cameras
    lamps = lamps_of(config, cameras, place) if lamps is None else lamps
    exposure = exposure_controls_of(config)
    sets = FrameSets(list(cameras.values()), config.measuring, Health(SystemClock()), exposure)
    leds = None if lamps is None else ScanLeds(lamps, known_unit_of(config, cameras))
    switches = switches_of(config, cameras, place) if switches is None else switches
    return Scanner(config, folder, sets, stage, leds, progress, switches)


def known_unit_of(config: Config, cameras: Mapping[str, Camera]) -> KnownUnit | str:
    """Return the calibrated unit, the reference for a scan's LED pairs, or the reason why there is none."""
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
