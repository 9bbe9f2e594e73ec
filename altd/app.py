"""The composition root: cameras, chain, board and publishers become one daemon."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import cv2

from altd import __version__
from altd.calibration.file import check_image_size, load_calibration
from altd.calibration.model import Calibration
from altd.config import (
    AravisCamera,
    CameraLamps,
    Config,
    LiveCamera,
    RecordingCamera,
    SerialPort,
    V4l2Camera,
)
from altd.devices.playback import Playback, PlaybackCamera
from altd.errors import BadInputError, bare
from altd.ports import Camera, Clock, Indicators, Lamps, Stage, SwitchingCamera
from altd.recording import Kind, Recording, UnitHeader, open_recording, refuse_used_folder
from altd.records import Frame, NoSpot, Spot
from altd.service.board import Board
from altd.service.chain import MeasuringChain, View
from altd.service.clock import SystemClock
from altd.service.exposing import ExposureKeeper, ExposureSetter
from altd.service.grabbing import grab
from altd.service.health import Component, Health, State
from altd.service.inbox import Inbox
from altd.service.indicators import IndicatorPanel
from altd.service.lamps import FrameLamps
from altd.service.manager import ServiceManager
from altd.service.pipeline import Pipeline
from altd.service.record import record
from altd.service.scan import Scanner, Teller
from altd.service.supervision import Publisher, keep_running

_FACES_START_S = 1.0


class Daemon:
    """One unit's daemon. ``cameras`` stand behind the config's camera names; the caller chooses them.

    So does it ``lamps`` and ``indicators``; ``self.lamps`` switches the first, for who wants light.
    """

    def __init__(
        self,
        config: Config,
        calibration: Calibration,
        cameras: Mapping[str, Camera],
        clock: Clock | None = None,
        lamps: Lamps | None = None,
        indicators: Indicators | None = None,
    ) -> None:
        self.config = config
        self.clock = clock or SystemClock()
        self.board = Board(self.clock, config.measuring.stale_after_s)
        self.health = Health(self.clock)
        self.health.facts |= {
            "version": __version__,
            "serial": config.unit.serial,
            "calibration": f"{calibration.created:%Y-%m-%d}, {calibration.recording_note}".rstrip(", "),
        }
        self.lamps: FrameLamps | None = None
        if lamps is not None:
            self.lamps = FrameLamps(lamps, self.health.component("lamps"), self.clock)
        self._indicators: IndicatorPanel | None = None
        if indicators is not None:
            component = self.health.component("indicators")
            self._indicators = IndicatorPanel(indicators, self.board, self.health, component, self.clock)
        views = [View(target.name, target.camera) for target in config.targets]
        self._cameras = {view.camera: cameras[view.camera] for view in views}
        self.chain = MeasuringChain(
            views,
            calibration,
            config.measuring,
            config.installation,
            lambda: (camera.origin for camera in self._cameras.values()),
            self.clock.utc,
            self._watch,
        )
        self._keepers = {
            name: ExposureKeeper(
                settings.exposure, settings.fps, config.measuring.window, self._camera_health(name)
            )
            for name, settings in config.cameras.items()
            if name in self._cameras and isinstance(settings, LiveCamera)
        }

    async def run(self) -> None:
        """Measure and publish until cancelled.

        Raises BadInputError for an address that is taken; any other failure of the pipeline ends the
        daemon with that failure. A publisher's failure never does.
        """
        cv2.setNumThreads(1)  # a frame is small: more threads cost more than they bring
        inbox = Inbox(self._cameras)
        faces = dict(self._publishers())
        manager = ServiceManager(self.board, self.clock, f"unit {self.config.unit.serial}", list(faces))
        try:
            async with asyncio.TaskGroup() as tasks:
                tried = [asyncio.Event() for _ in faces]
                for (place, publisher), first_try in zip(faces.items(), tried, strict=True):
                    component = self.health.component(place)
                    face = keep_running(place, publisher, component, self.clock, first_try.set)
                    tasks.create_task(face, name=place)
                await _all_of(tried)
                for name, camera in self._cameras.items():
                    keeper = self._keepers.get(name)
                    grabbing = grab(
                        camera, inbox, self._camera_health(name), keeper.setter if keeper else None
                    )
                    tasks.create_task(grabbing, name=f"camera {name}")
                pipeline = Pipeline(
                    inbox,
                    self.chain,
                    self.board,
                    self.health.component("measuring"),
                    self.clock,
                    self.config.measuring.silent_after_s,
                    manager.progress,
                )
                tasks.create_task(pipeline.run(), name="pipeline")
                await self._lights()  # inside: told to end, they are dark before a camera is closed
        except BaseExceptionGroup as group:
            refused = bare(group, BadInputError)
            if refused is None:
                raise
            raise refused from None

    async def _lights(self) -> None:
        """Keep lamps and indicators, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            for name, lights in (("lamps", self.lamps), ("indicators", self._indicators)):
                if lights is not None:
                    tasks.create_task(lights.run(), name=name)

    def _camera_health(self, name: str) -> Component:
        return self.health.component(f"camera {name}")

    def _watch(self, frame: Frame, spot: Spot | NoSpot) -> None:
        if (keeper := self._keepers.get(frame.camera)) is not None:
            keeper.see(frame, spot)

    def _publishers(self) -> Iterator[tuple[str, Publisher]]:
        """The faces that the config asks for, with their places in it. Imported only when wanted."""
        config, board, health = self.config, self.board, self.health
        if config.modbus_tcp is not None:
            from altd.publish.modbus.tcp import ModbusTcpPublisher

            place = f"modbus_tcp {config.modbus_tcp.host}:{config.modbus_tcp.port}"
            yield place, ModbusTcpPublisher(config.modbus_tcp, board, health.component(place))
        if config.http is not None:
            from altd.publish.http.publisher import HttpPublisher

            place = f"http {config.http.host}:{config.http.port}"
            yield place, HttpPublisher(config.http, board, health, health.component(place))
        for port in config.serial:
            place = f"serial {port.device}"
            yield place, self._serial_publisher(port, place)

    def _serial_publisher(self, port: SerialPort, place: str) -> Publisher:
        component = self.health.component(place)
        if port.speaks == "modbus_rtu":
            from altd.publish.modbus.rtu import ModbusRtuPublisher

            return ModbusRtuPublisher(port, self.board, component)
        from altd.publish.serial.publisher import ConsolePublisher, TelegramPublisher

        if port.speaks == "telegram":
            return TelegramPublisher(port, self.board, component, self.clock)
        return ConsolePublisher(port, self.board, self.health, component, self.clock)


def cameras_of(config: Config, place: Path) -> dict[str, Camera]:
    """The cameras that a config asks for; raises BadInputError that names ``place`` or the recording."""
    if not config.cameras:
        raise BadInputError(place, "cameras: no [cameras.…] table")
    recordings: dict[Path, tuple[Recording, Playback]] = {}
    cameras: dict[str, Camera] = {}
    for name in (target.camera for target in config.targets):
        settings = config.cameras[name]
        if isinstance(settings, RecordingCamera):
            if settings.path not in recordings:
                recording = open_recording(settings.path)
                playback = Playback(recording, settings.pace == "realtime", settings.repeat)
                recordings[settings.path] = recording, playback
            cameras[name] = PlaybackCamera(name, recordings[settings.path][1])
        else:
            cameras[name] = _live_camera(name, settings)
    return cameras


def _live_camera(name: str, settings: V4l2Camera | AravisCamera) -> Camera:
    """The driver behind a camera's table. Imported only when wanted."""
    if isinstance(settings, V4l2Camera):
        from altd.devices.v4l2.camera import V4l2Camera as Video4LinuxCamera

        return Video4LinuxCamera(name, settings)
    try:
        from altd.devices.aravis.driver import AravisCamera as GigeVisionCamera
    except ImportError as error:
        raise BadInputError(f"cameras.{name}", str(error)) from error
    return GigeVisionCamera(name, settings)


def calibration_of(config: Config, cameras: Mapping[str, Camera]) -> Calibration:
    """The config's calibration, checked against its unit, targets and cameras; raises BadInputError."""
    path = config.unit.calibration
    calibration = load_calibration(path, config.unit.serial)
    for target in config.targets:
        known = calibration.target(target.name)
        if known is None:
            raise BadInputError(path, f"does not know target {target.name!r}")
        if abs(known.z_mm - target.z_mm) > 1e-3:
            raise BadInputError(
                path, f"target {target.name!r} was calibrated at z {known.z_mm:g} mm, not {target.z_mm:g}"
            )
        camera, settings = cameras.get(target.camera), config.cameras.get(target.camera)
        if isinstance(camera, PlaybackCamera):
            check_image_size(calibration, path, target.name, camera.width, camera.height)
        elif isinstance(settings, LiveCamera):
            check_image_size(calibration, path, target.name, settings.width, settings.height)
    return calibration


def daemon_of(config: Config, place: Path) -> Daemon:
    """The daemon that a config file describes; raises BadInputError that names the file and the place."""
    cameras = cameras_of(config, place)
    calibration = calibration_of(config, cameras)
    lamps, indicators = lamps_of(config, cameras, place), indicators_of(config)
    daemon = Daemon(config, calibration, cameras, lamps=lamps, indicators=indicators)
    for component in ("measuring", *(f"camera {name}" for name in cameras)):
        daemon.health.component(component).say(State.STARTING)
    return daemon


def lamps_of(config: Config, cameras: Mapping[str, Camera], place: Path, alone: bool = False) -> Lamps | None:
    """The frame LEDs that a config asks for, on lines or on ``cameras``; None when it has none.

    ``alone``: nobody takes frames of these cameras. Raises BadInputError that names ``place``.
    """
    if config.lamps is None:
        return None
    if not isinstance(config.lamps, CameraLamps):
        from altd.devices.gpio.lamps import GpioFrameLamps

        return GpioFrameLamps(config.lamps)
    from altd.devices.camera_lamps import CameraLamps as LampsOnCameras

    switching: dict[str, SwitchingCamera] = {}
    for name in config.lamps.cameras:
        camera = cameras[name]
        if not isinstance(camera, SwitchingCamera):
            raise BadInputError(place, f"lamps: camera {name!r} has no output to switch")
        switching[name] = camera
    return LampsOnCameras(switching, config.lamps.line, alone)


def indicators_of(config: Config) -> Indicators | None:
    """The lamps on the housing that a config asks for; None when it has none."""
    if config.indicators is None:
        return None
    from altd.devices.gpio.lamps import GpioIndicators

    return GpioIndicators(config.indicators)


async def record_of(config: Config, place: Path, folder: Path, seconds: float, kind: Kind) -> int:
    """Record from the config's cameras into ``folder``; returns the number of exposures."""
    refuse_used_folder(folder)
    cameras = cameras_of(config, place)
    clock = SystemClock()
    distance_mm = max(target.z_mm for target in config.targets) - min(t.z_mm for t in config.targets)
    unit = UnitHeader(serial=config.unit.serial, target_distance_mm=distance_mm)
    return await record(
        list(cameras.values()),
        folder,
        unit,
        config.measuring,
        Health(clock),
        clock.utc,
        seconds,
        kind,
        setters=setters_of(config),
    )


def setters_of(config: Config) -> dict[str, ExposureSetter]:
    """For a recording or a scan: each live camera gets its exposure from the config once, and keeps it."""
    return {
        name: ExposureSetter(settings.exposure, settings.fps)
        for name, settings in config.cameras.items()
        if isinstance(settings, LiveCamera) and settings.exposure.control != "camera"
    }


def stage_of(config: Config, place: Path) -> Stage:
    """The stage that a config asks for; raises BadInputError that names ``place``."""
    if config.stage is None:
        raise BadInputError(place, "stage: no [stage] table")
    from altd.devices.grbl.driver import GrblStage

    return GrblStage(config.stage)


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
    clock, setters = SystemClock(), setters_of(config)
    return Scanner(config, folder, list(cameras.values()), stage, lamps, clock, teller, setters)


async def _all_of(tried: Sequence[asyncio.Event]) -> None:
    """Let every face try to start before the first frame comes: a mistake in the config is the first word.

    A face that takes long does not keep the unit from measuring.
    """
    try:
        async with asyncio.timeout(_FACES_START_S):
            for event in tried:
                await event.wait()
    except TimeoutError:
        return
