"""The composition root: cameras, chain, board and publishers become one daemon."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import cv2

from altd import __version__
from altd.acquisition.acquiring import acquire
from altd.acquisition.auto_exposure.control import ExposureControl
from altd.acquisition.lamps.frame_leds import FrameLamps
from altd.acquisition.lamps.indicators import IndicatorPanel
from altd.acquisition.latest_frames import LatestFrames
from altd.acquisition.latest_of_each import LatestOfEach
from altd.acquisition.locating import locate_frames
from altd.acquisition.pipeline import Pipeline
from altd.app.parts import calibration_of, cameras_of, indicators_of, lamps_of
from altd.config import (
    AnySerialPortSettings,
    Config,
    LiveCameraSettings,
    ModbusRtuPortSettings,
    TelegramPortSettings,
)
from altd.errors import BadInputError, bare
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.measuring.spot_locator import Located
from altd.ports import Camera, Clock, Indicators, Lamps
from altd.records import CameraIdentity, Fault, origin_faults
from altd.runtime.clock import SystemClock
from altd.runtime.service_manager import ServiceManager
from altd.runtime.supervision import Publisher, keep_running
from altd.status.board import Board
from altd.status.health import MEASURING, Health, State

_FACES_START_TIMEOUT_S = 1.0


class Daemon:
    """One unit's daemon. ``cameras`` stand behind the config's camera names; the caller chooses them.

    ``lamps`` and ``indicators`` are the caller's choice too; ``self.lamps`` switches the frame LEDs.
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
        instrument = BeamInstrument(calibration, config.measuring, config.installation)
        self.board = Board(self.clock, config.measuring.stale_after_s, instrument.quantities)
        self.health = Health(self.clock)
        self.health.facts |= {
            "version": __version__,
            "serial": config.unit.serial,
            "calibration": _about(calibration),
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
            instrument,
            self._origin_faults,
            self.clock.utc,
            lambda camera: self._cameras[camera].identity,
            {
                name: CameraIdentity(serial=settings.serial)
                for name, settings in config.cameras.items()
                if isinstance(settings, LiveCameraSettings)
            },
        )
        self._exposure = {
            name: ExposureControl(settings.exposure, settings.fps, config.measuring.window)
            for name, settings in config.cameras.items()
            if name in self._cameras and isinstance(settings, LiveCameraSettings)
        }

    async def run(self) -> None:
        """Measure and publish until cancelled.

        Raises BadInputError for an address that is taken; any other failure of the pipeline ends the
        daemon with that failure. A publisher's failure never does.
        """
        cv2.setNumThreads(1)  # a frame is small: more threads cost more than they bring
        frames = LatestFrames(self._cameras)
        located = LatestOfEach[Located](self._cameras, self.clock)
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
                for camera in self._cameras.values():
                    self._measure_camera(tasks, camera, frames, located)
                pipeline = Pipeline(
                    located,
                    frames,
                    self.chain,
                    self.board,
                    self.health.component(MEASURING),
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

    def _measure_camera(
        self,
        tasks: asyncio.TaskGroup,
        camera: Camera,
        frames: LatestFrames,
        located: LatestOfEach[Located],
    ) -> None:
        """One thread acquires a camera's frames, another one locates the spot in the newest of them."""
        exposure = self._exposure.get(camera.name)
        health = self.health.component(f"camera {camera.name}")
        acquiring = tasks.create_task(acquire(camera, frames, health, exposure), name=health.name)
        acquiring.add_done_callback(lambda _: frames.end(camera.name))
        locating = locate_frames(frames, self.chain.locators[camera.name], located, exposure, camera.waits)
        tasks.create_task(locating, name=f"locate {camera.name}")

    async def _lights(self) -> None:
        """Keep lamps and indicators, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            for name, lights in (("lamps", self.lamps), ("indicators", self._indicators)):
                if lights is not None:
                    tasks.create_task(lights.run(), name=name)

    def _origin_faults(self) -> tuple[Fault, ...]:
        cameras = self._cameras.values()
        played = [camera.name for camera in cameras if camera.playback]
        return origin_faults({camera.name: camera.origin for camera in cameras}, played)

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

    def _serial_publisher(self, port: AnySerialPortSettings, place: str) -> Publisher:
        component = self.health.component(place)
        if isinstance(port, ModbusRtuPortSettings):
            from altd.publish.modbus.rtu import ModbusRtuPublisher

            return ModbusRtuPublisher(port, self.board, component)
        from altd.publish.serial.publisher import ConsolePublisher, TelegramPublisher

        if isinstance(port, TelegramPortSettings):
            return TelegramPublisher(port, self.board, component, self.clock)
        return ConsolePublisher(port, self.board, self.health, component, self.clock)


def daemon_of(config: Config, place: Path) -> Daemon:
    """The daemon that a config file describes; raises BadInputError that names the file and the place."""
    cameras = cameras_of(config, place)
    calibration = calibration_of(config, cameras)
    lamps, indicators = lamps_of(config, cameras, place), indicators_of(config)
    daemon = Daemon(config, calibration, cameras, lamps=lamps, indicators=indicators)
    for component in (MEASURING, *(f"camera {name}" for name in cameras)):
        daemon.health.component(component).say(State.STARTING)
    return daemon


def _about(calibration: Calibration) -> str:
    made, note = f"{calibration.created:%Y-%m-%d}", calibration.recording_note
    return ", ".join(filter(None, (made, note, "from SIMULATED frames" if calibration.simulated else "")))


async def _all_of(tried: Sequence[asyncio.Event]) -> None:
    """Let every face try to start before the first frame comes: a mistake in the config is the first word.

    A face that takes long does not keep the unit from measuring.
    """
    try:
        async with asyncio.timeout(_FACES_START_TIMEOUT_S):
            for event in tried:
                await event.wait()
    except TimeoutError:
        return
