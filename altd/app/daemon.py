"""Composition root: combines cameras, chain, board and publishers into one daemon."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from functools import partial
from hashlib import sha256
from pathlib import Path

import cv2

from altd import __version__
from altd.acquisition.acquiring import acquire
from altd.acquisition.auto_exposure.control import ExposureControl
from altd.acquisition.frame_pairs import FramePairs, Marks
from altd.acquisition.glasses import glass_cycle
from altd.acquisition.inclination.monitor import InclinationMonitor, stated_inclination
from altd.acquisition.kept_frames.ring import FrameRing
from altd.acquisition.lamps.controller import FrameLamps, LampController
from altd.acquisition.lamps.indicators import IndicatorPanel
from altd.acquisition.locating import LocatedPairs, Locating
from altd.acquisition.pictures import Pictures
from altd.acquisition.pipeline import Pipeline
from altd.acquisition.self_check.exposing import CheckExposer
from altd.acquisition.self_check.frames import MarkedFrames
from altd.acquisition.self_check.geometry_state import GeometryState
from altd.acquisition.self_check.service import SelfChecks
from altd.app.baseline import BaselineKeeper, with_baseline_kept
from altd.app.calibration_files import ReadCalibrationFiles
from altd.app.diagnostics import diagnostic_parts
from altd.app.instruments import live_instrument, views_of
from altd.app.interfaces import Interfaces, interfaces_of
from altd.app.keeping import DaemonHistory, folder_of_recordings, frame_keeper
from altd.app.level import alignment_of
from altd.app.maintenance import MaintenanceWatches
from altd.app.operating_time import OperatingTime, file_in
from altd.app.parts import (
    AnyCalibration,
    calibration_of_instrument,
    cameras_of,
    lamps_of,
    missing_files,
    switches_of,
)
from altd.app.reloading import Reloading
from altd.app.self_check import check_parts_of, fps_of, geometry_of, why_unchecked
from altd.config import Config, LiveCameraSettings
from altd.devices.camera_lamps import CameraLampsSettings, CameraSwitchesSettings
from altd.errors import BadInputError, one_line, unwrap_group
from altd.instruments.beam.points import MachinePoints
from altd.measuring.chain import MeasuringChain
from altd.measuring.frame_chain import Provenance, Seen
from altd.ports import Camera, Clock, Indicators, Lamps, Switches
from altd.records import Fault, origin_faults
from altd.runtime.clock import SystemClock, time_zone
from altd.runtime.computer import watch_computer
from altd.runtime.service_manager import ServiceManager, state_folder
from altd.runtime.threads import real_time_interpreter
from altd.status.board import Board
from altd.status.health import COMPUTER, MEASURING, Health, State
from altd.status.maintenance import due_date
from altd.status.proof import Identity, unit_number
from altd.status.state import UnitState
from altd.status.unit import PublishedUnit, UnitFacts
from altd.vision import kernel


class Daemon:
    """One unit's daemon. The caller chooses ``cameras``, by the config's camera names.

    The caller also chooses ``lamps``, ``indicators`` and the ``switches`` of the glasses; ``self.lamps``
    switches the frame LEDs. Played and simulated frames give valid values only with ``rehearsal``. Raises
    BadInputError for a stored baseline that does not match.
    """

    def __init__(  # noqa: PLR0913  the parts of a unit
        self,
        config: Config,
        calibration: AnyCalibration,
        cameras: Mapping[str, Camera],
        clock: Clock | None = None,
        lamps: Lamps | None = None,
        indicators: Indicators | None = None,
        rehearsal: bool = False,
        switches: Switches | None = None,
    ) -> None:
        self.config = config
        self.clock = clock or SystemClock()
        geometry = geometry_of(config, calibration, self.clock)
        instrument = live_instrument(
            config,
            calibration,
            lambda: self._maintenance.frame_celsius(),
            None if geometry is None else geometry.correct,
        )
        identity = Identity.drawn(config.unit.serial)
        facts = UnitFacts(
            kind="desk" if config.unit.kind == "desk" else "",
            version=__version__,
            serial=config.unit.serial,
            unit_number=f"{identity.unit:08X}",
            spot_fit=kernel.description,
            calibration=_about(calibration),
            calibration_valid_until=due_date(calibration.created, config.maintenance.calibration_due_days),
            time_zone=time_zone(),
        )
        self.health = Health(self.clock)
        self.reloading: Reloading | None = None
        """Reloads the settings; None: they were not read from a file."""
        self._calibrated = calibration.created.date()
        self._inclination: InclinationMonitor | None = None
        self._state_folder: Path | None = None
        self._operating_time: OperatingTime | None = None
        if (of := config.inclinometer) is not None:
            component, place = self.health.component("inclinometer"), config.installation
            alignment = alignment_of(of, config.unit.serial)
            stated = stated_inclination(config.machine)
            self._inclination = InclinationMonitor(
                of.inclinometer(), of, place, component, self.clock, alignment, stated
            )
        self.board = Board(
            self.clock,
            instrument.stale_after_s,
            instrument.quantities,
            identity,
            None if self._inclination is None else self._inclination.sense,
            rehearsal,
            MachinePoints(config.machine, config.installation).finish if config.machine else None,
        )
        self._maintenance = MaintenanceWatches(config, calibration, cameras, self.health, self.clock)
        self.state = UnitState(self.board, self.health, self.clock, self._maintenance.watches)
        self.unit = PublishedUnit(
            self.board,
            self.health,
            facts,
            instrument.areas,
            self.state.read,
            instrument.figures,
            ReadCalibrationFiles(config.unit.calibration, calibration.file),
            diagnostic_parts(config),
        )
        self.past = DaemonHistory(self.unit, self.state)
        self.lamps: FrameLamps | None = None
        if lamps is not None:
            self.lamps = FrameLamps(lamps, self.health.component("lamps"), self.clock)
        self._indicators: IndicatorPanel | None = None
        if indicators is not None:
            component = self.health.component("indicators")
            self._indicators = IndicatorPanel(indicators, self.unit, component)
        self._switches: LampController[str] | None = None
        if switches is not None:
            component = self.health.component("switches")
            self._switches = LampController(switches, switches.show, "", component, self.clock)
        self._views = instrument.views
        self._cameras = {view.camera: cameras[view.camera] for view in self._views}
        self.chain = instrument.chain(
            Provenance(
                origins=self._origin_faults,
                identity=lambda camera: self._cameras[camera].identity,
                utc=self.clock.utc,
            )
        )
        self._baseline = BaselineKeeper.of(config, calibration, self.chain, self.board, self.health)
        self.checks = self._self_checks(geometry)
        self._exposure = {
            name: ExposureControl(settings.exposure, settings.fps, config.measuring.window)
            for name, settings in config.cameras.items()
            if name in self._cameras and isinstance(settings, LiveCameraSettings)
        }

    def _self_checks(self, geometry: GeometryState | None) -> SelfChecks | None:
        """Return the checks with the frame LEDs of a beam's targets; None: the unit cannot make them."""
        if geometry is None or not isinstance(self.chain, MeasuringChain):
            self.unit.self_check.unavailable = "this instrument has no frame LEDs"
            return None
        is_desk = self.config.unit.kind == "desk"
        if why := why_unchecked(geometry.calibration, self._cameras, self.lamps is not None, is_desk):
            self.unit.self_check.unavailable = why
            return None
        views, locators = views_of(self.config), self.chain.locators
        parts = check_parts_of(self.config, geometry, views, locators, self.clock)
        targets = {view.camera: view.target for view in self._views}
        component = self.health.component("self-check")
        return SelfChecks(parts, targets, self.unit.self_check, component, self.clock)

    def keep_state_in(self, folder: Path) -> None:
        """Keep operating hours and data of checks and recordings in this folder. Call before ``run``."""
        self._state_folder = folder
        component = self.health.component("operating time")
        self._operating_time = OperatingTime(file_in(folder, self.config.unit.serial), component)
        self.unit.operating_hours = self._operating_time.hours
        if self.checks is not None:
            path = folder / f"self-checks-{unit_number(self.config.unit.serial):08X}.json"
            self.checks.memory.keep_in(path, self.health.component("self-check history"))

    async def run(self, reload: asyncio.Event | None = None) -> None:
        """Measure and publish until cancelled; each time ``reload`` is set, reload the settings.

        Raises BadInputError for an unusable file of an interface. Any failure of the pipeline ends the daemon
        with that failure; a failure of a publisher never does.
        """
        async with self.past.recorded():
            await self._run(reload)

    async def _run(self, reload: asyncio.Event | None) -> None:
        cv2.setNumThreads(1)  # for small frames, more threads cost more time than they save
        config, board, clock = self.config, self.board, self.clock
        manager = ServiceManager(board, clock, f"unit {config.unit.serial}", list(interfaces_of(config)))
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self.state.run(), name="state")
                if self._operating_time is not None:
                    tasks.create_task(self._operating_time.run(), name="operating time")
                if self._baseline is not None:
                    tasks.create_task(self._baseline.run(), name="baseline")
                self._maintenance.start(tasks)
                watching = watch_computer(self.health.component(COMPUTER), clock)
                tasks.create_task(watching, name=COMPUTER)
                about = clock, self._calibrated, config.installation
                interfaces = Interfaces(self.unit, self.past, *about, tasks)
                await interfaces.start(config)
                with real_time_interpreter():
                    self._measure(tasks, manager)
                    if self._inclination is not None:
                        tasks.create_task(self._inclination.run(), name="inclinometer")
                    if self.reloading is not None and reload is not None:
                        reloading = self.reloading.run(reload, interfaces, manager)
                        tasks.create_task(reloading, name="reload")
                    await self._lights()  # inside: on cancellation lamps darken before a camera is closed
                    await asyncio.Event().wait()  # a unit without lamps needs the real-time interpreter too
        except BaseExceptionGroup as group:
            refused = unwrap_group(group, BadInputError)
            if refused is None:
                raise
            raise refused from None

    def _measure(self, tasks: asyncio.TaskGroup, manager: ServiceManager) -> None:
        """Start a thread per camera, one to locate the spots of the newest frame set, and the pipeline."""
        pictures = Pictures(self._views, self.clock)
        self.unit.pictures.open(pictures)
        tasks.create_task(pictures.run(), name="pictures")
        locating = Locating(self.chain.locators, self._exposure, pictures.put)
        pairs = FramePairs(
            self.chain.pairer, locating.arrived, self.clock, self._marks(tasks), self._ring(tasks)
        )
        located: LocatedPairs[Seen] = LocatedPairs(pairs)
        for name, camera in self._cameras.items():
            exposure, health = self._exposure.get(name), self.health.component(f"camera {name}")
            acquiring = tasks.create_task(acquire(camera, pairs, health, exposure), name=health.name)
            acquiring.add_done_callback(partial(_end_of, pairs, name))
        tasks.create_task(locating.run(located), name="locate")
        pipeline = Pipeline(
            located,
            self.chain,
            self.board,
            self.health.component(MEASURING),
            manager.progress,
            self.checks,
            self._maintenance.trends,
            self.past.record,
        )
        tasks.create_task(pipeline.run(), name="pipeline")

    def _ring(self, tasks: asyncio.TaskGroup) -> FrameRing | None:
        """Start the keeper of the last frames and return its ring; None: the config does not allow it."""
        recordings, folder = self.unit.recordings, folder_of_recordings(self.config, self._state_folder)
        if self.config.unit.instrument == "planar" and self.config.plate is None:
            recordings.unavailable = "there is no [plate] table, which a recording of a plate needs"
            return None
        if not self.config.kept_frames.memory_mb:
            recordings.unavailable = "kept_frames.memory_mb is 0"
            return None
        if folder is None:
            recordings.unavailable = "kept_frames.folder is not set, and there is no service folder"
            return None
        note = self.past.note_recording
        keeper = frame_keeper(self.config, self._cameras, folder, self.state, self.unit, note)
        tasks.create_task(keeper.run(), name="kept frames")
        return keeper.ring

    def _marks(self, tasks: asyncio.TaskGroup) -> list[Marks]:
        """Start the cycle of the glasses and the checks; return their marks of frames."""
        all_marks: list[Marks] = []
        if self._switches is not None:
            cycle = glass_cycle(self._switches, self.config, fps_of(self.config), self.clock)
            tasks.create_task(cycle.run(), name="cycle of the glasses")
            all_marks.append(cycle.marks)
        if self.checks is None:
            return all_marks
        assert self.lamps is not None  # noqa: S101  required by ``_self_checks``
        leds = self.checks.leds
        marks = MarkedFrames(leds, self._cameras)
        exposures, fps = self.config.self_check.exposures, fps_of(self.config)
        exposer = CheckExposer(self.lamps, leds, marks, self.clock, exposures, fps)
        tasks.create_task(self.checks.run(exposer, self.lamps, marks), name="self-check")
        return [*all_marks, marks]

    async def _lights(self) -> None:
        """Control lamps, glasses and indicators until cancelled."""
        lamps = self.config.lamps
        switching = lamps.cameras if isinstance(lamps, CameraLampsSettings) else ()
        async with asyncio.TaskGroup() as tasks:
            if self._switches is not None:
                by_camera = isinstance(self.config.switches, CameraSwitchesSettings)
                outputs = [target.camera for target in self.config.switched_targets if by_camera]
                opened = [self.health.component(f"camera {name}") for name in outputs]
                tasks.create_task(self._switches.run(opened), name="switches")
            if self.lamps is not None:
                cameras = [self.health.component(f"camera {name}") for name in switching]
                tasks.create_task(self.lamps.run(cameras), name="lamps")
            if self._indicators is not None:
                tasks.create_task(self._indicators.run(), name="indicators")

    def _origin_faults(self) -> tuple[Fault, ...]:
        cameras = self._cameras.values()
        played = [camera.name for camera in cameras if camera.playback]
        return origin_faults({camera.name: camera.origin for camera in cameras}, played)


def daemon_of(config: Config, place: Path, rehearsal: bool = False) -> Daemon:
    """Return the daemon described by a config file; raises BadInputError that names file and key."""
    if missing := missing_files(config):
        raise BadInputError(place, *map(str, missing))
    cameras = cameras_of(config, place)
    calibration = calibration_of_instrument(config, cameras)
    lamps = lamps_of(config, cameras, place)
    indicators = None if config.indicators is None else config.indicators.indicators()
    switches, loaded = switches_of(config, cameras, place), config
    if switches is not None:
        config = with_baseline_kept(config, place)
    daemon = Daemon(
        config,
        calibration,
        cameras,
        lamps=lamps,
        indicators=indicators,
        rehearsal=rehearsal,
        switches=switches,
    )
    for component in (MEASURING, *(f"camera {name}" for name in cameras)):
        daemon.health.component(component).set_state(State.STARTING)
    if (folder := state_folder()) is not None:
        daemon.keep_state_in(folder)
    digest = sha256(place.read_bytes()).hexdigest()
    daemon.unit.facts = daemon.unit.facts.model_copy(update={"config_sha256": digest})
    daemon.past.keep_as(config, calibration)
    daemon.reloading = Reloading(place, loaded, calibration, daemon.unit)
    return daemon


def _end_of(pairs: FramePairs, camera: str, _: object) -> None:
    """Note that a camera delivers no more frames."""
    pairs.end(camera)


def _about(calibration: AnyCalibration) -> str:
    made, note = f"{calibration.created:%Y-%m-%d}", one_line(calibration.recording_note)
    return ", ".join(filter(None, (made, note, "from SIMULATED frames" if calibration.simulated else "")))
