"""The parts required by a config, each behind its port; a driver is imported only if used."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from altd.acquisition.auto_exposure.control import ExposureControl
from altd.app.baseline import baseline_file
from altd.calibration.file import check_camera, check_image_size, check_place, load_calibration, target_of
from altd.calibration.planar_file import check_planar_camera, load_planar_calibration
from altd.config import (
    AravisCameraSettings,
    CameraLampsSettings,
    CameraSwitchesSettings,
    Config,
    InclinometerSettings,
    LiveCameraSettings,
    RecordingCameraSettings,
    V4l2CameraSettings,
    software_triggered,
)
from altd.devices.playback import Playback, PlaybackCamera
from altd.devices.trigger_times import TriggerTimes
from altd.errors import BadInputError
from altd.files.reading import check_rights
from altd.instruments.planar.instrument import PlanarCalibration
from altd.measuring.calibration import Calibration
from altd.ports import Camera, Inclinometer, Indicators, Lamps, Stage, Switches, SwitchingCamera
from altd.recording.header import LedPlateHeader
from altd.recording.reader import open_recording
from altd.records import CameraIdentity
from altd.runtime.clock import SystemClock

AnyCalibration = Calibration | PlanarCalibration


@dataclass(frozen=True, slots=True)
class MissingFile:
    """A missing file or folder that a config names, and the command that makes it."""

    keys: str
    path: Path
    maker: str

    def __str__(self) -> str:
        whole = (
            "; ~ is not a user's home directory here: write the full path" if "~" in self.path.parts else ""
        )
        return f"{self.keys}: {self.path} does not exist yet; {self.maker} makes it{whole}"


def missing_files(config: Config) -> list[MissingFile]:
    """Return the files that `altd run` would not find."""
    played: dict[Path, list[str]] = {}
    for name, camera in config.cameras.items():
        if isinstance(camera, RecordingCameraSettings):
            played.setdefault(camera.path, []).append(f"cameras.{name}.path")
    named = [MissingFile("unit.calibration", config.unit.calibration, "altd calibrate")]
    named += [MissingFile(", ".join(keys), path, "altd record") for path, keys in played.items()]
    return [file for file in named if not os.path.lexists(file.path)]


def check_files(config: Config) -> tuple[AnyCalibration | None, list[BadInputError]]:
    """Return the calibration (None: unusable or missing) and the errors of the existing files of a config."""
    missing = {file.path for file in missing_files(config)}
    cameras: dict[str, Camera] = {}
    errors: dict[str, BadInputError] = {}
    playbacks = _Playbacks()
    for name, settings in config.cameras.items():
        if isinstance(settings, RecordingCameraSettings) and settings.path not in missing:
            try:
                cameras[name] = playbacks.camera(name, settings)
            except BadInputError as error:
                errors.setdefault(str(error), error)
    calibration = None
    if config.unit.calibration not in missing:
        try:
            calibration = calibration_of_instrument(config, cameras)
            if isinstance(calibration, Calibration) and (baseline := baseline_file(config, calibration)):
                baseline.load()
        except BadInputError as error:
            errors.setdefault(str(error), error)
    for check in interface_checks(config):
        try:
            check()
        except BadInputError as error:
            errors.setdefault(str(error), error)
    return calibration, list(errors.values())


def interface_checks(config: Config) -> Iterator[Callable[[], object]]:
    """Yield the interfaces' own readers of their files; each raises BadInputError."""
    from altd.credentials.certificates import client_context, server_context
    from altd.credentials.file import load_credentials, load_login

    http, mqtt, modbus = config.http, config.mqtt, config.modbus_tcp
    if modbus is not None and modbus.certificate is not None and modbus.key is not None:
        yield partial(server_context, modbus.certificate, modbus.key, modbus.client_ca)
    if http is not None and http.credentials is not None:
        yield partial(load_credentials, http.credentials)
    if http is not None and http.certificate is not None and http.key is not None:
        yield partial(server_context, http.certificate, http.key)
    if mqtt is not None and mqtt.credentials is not None:
        yield partial(load_login, mqtt.credentials)
    if mqtt is not None and mqtt.ca is not None:
        yield partial(client_context, mqtt.ca, mqtt.certificate, mqtt.key)
    if config.opcua is not None:
        from altd.publish.opcua.publisher import check_opcua

        yield partial(check_opcua, config.opcua)


def cameras_of(config: Config, place: Path) -> dict[str, Camera]:
    """Return the cameras of a config; raises BadInputError that names ``place`` or the recording."""
    if not config.cameras:
        raise BadInputError(place, "cameras: no [cameras.…] table")
    playbacks = _Playbacks()
    cameras: dict[str, Camera] = {}
    triggers = trigger_times_of(config)
    for name in config.measuring_cameras:
        settings = config.cameras[name]
        if isinstance(settings, RecordingCameraSettings):
            cameras[name] = playbacks.camera(name, settings)
        else:
            cameras[name] = live_camera(name, settings, triggers)
    return cameras


def trigger_times_of(config: Config) -> TriggerTimes | None:
    """Return the instants at which software triggers the cameras, such as all can take; None: it does not."""
    software = list(software_triggered(config.cameras).values())
    if not software:
        return None
    busy_ms = max(camera.busy_ms for camera in software)
    return TriggerTimes(round(1e9 / software[0].fps), round(1e6 * busy_ms))


class _Playbacks:
    """Playbacks of recordings; all cameras of a recording share one."""

    def __init__(self) -> None:
        self._playbacks: dict[Path, Playback] = {}

    def camera(self, name: str, settings: RecordingCameraSettings) -> PlaybackCamera:
        """Return a camera of a recording; raises BadInputError that names the recording."""
        playback = self._playbacks.get(settings.path)
        if playback is None:
            recording = open_recording(settings.path)
            playback = Playback(recording, SystemClock(), settings.pace == "realtime", settings.repeat)
            self._playbacks[settings.path] = playback
        return PlaybackCamera(name, playback)


def live_camera(
    name: str, settings: V4l2CameraSettings | AravisCameraSettings, triggers: TriggerTimes | None = None
) -> Camera:
    """Return the driver for a camera's table, imported only if used; BadInputError if the import fails."""
    if isinstance(settings, V4l2CameraSettings):
        from altd.devices.v4l2.camera import V4l2Camera

        return V4l2Camera(name, settings)
    try:
        from altd.devices.aravis.driver import AravisCamera
    except ImportError as error:
        raise BadInputError(f"cameras.{name}", str(error)) from error
    return AravisCamera(name, settings, triggers)


def calibration_of(config: Config, cameras: Mapping[str, Camera]) -> Calibration:
    """Load the config's calibration and check its unit, targets and cameras; raises BadInputError."""
    path = config.unit.calibration
    check_rights(path)
    calibration = load_calibration(path, config.unit.serial)
    for target in config.targets:
        target_of(calibration, path, target.name)
        check_place(calibration, path, target.name, target.z_mm, target.glass)
        camera, settings = cameras.get(target.camera), config.cameras.get(target.camera)
        if isinstance(camera, PlaybackCamera):
            check_image_size(calibration, path, target.name, camera.width, camera.height)
            check_camera(calibration, path, target.name, camera.identity)
        elif isinstance(settings, LiveCameraSettings):
            check_image_size(calibration, path, target.name, settings.width, settings.height)
    return calibration


def calibration_of_instrument(config: Config, cameras: Mapping[str, Camera]) -> AnyCalibration:
    """Load the calibration of the config's instrument and check unit and cameras; raises BadInputError."""
    if config.unit.instrument != "planar":
        return calibration_of(config, cameras)
    path = config.unit.calibration
    check_rights(path)
    calibration = load_planar_calibration(path, config.unit.serial)
    for name, settings in config.cameras.items():
        camera = cameras.get(name)
        if isinstance(camera, PlaybackCamera):
            check_planar_camera(calibration, path, name, (camera.width, camera.height), camera.identity)
        elif isinstance(settings, LiveCameraSettings):
            size = settings.width, settings.height
            check_planar_camera(calibration, path, name, size, CameraIdentity())
    return calibration


def led_plate_of(config: Config) -> LedPlateHeader | None:
    """Return the plate of a config for the header of a recording; None: the config has none."""
    of = config.plate
    return None if of is None else LedPlateHeader(leds_mm=of.leds_mm, disc_mm=of.disc_mm)


def exposure_controls_of(config: Config) -> dict[str, ExposureControl]:
    """Return controls for a recording or scan: each live camera gets the config's exposure and keeps it."""
    return {
        name: ExposureControl(settings.exposure, settings.fps, config.measuring.window)
        for name, settings in config.cameras.items()
        if isinstance(settings, LiveCameraSettings) and settings.exposure.control != "camera"
    }


def lamps_of(config: Config, cameras: Mapping[str, Camera], place: Path, alone: bool = False) -> Lamps | None:
    """Return the frame LEDs of a config, on GPIO lines or on ``cameras``; None: it has none.

    ``alone``: no daemon acquires frames of these cameras. Raises BadInputError that names ``place``.
    """
    if config.lamps is None:
        return None
    if not isinstance(config.lamps, CameraLampsSettings):
        from altd.devices.gpio.lamps import GpioFrameLamps

        return GpioFrameLamps(config.lamps)
    from altd.devices.camera_lamps import CameraLamps

    switching = {name: _switching(cameras, name, place, "lamps") for name in config.lamps.cameras}
    return CameraLamps(switching, config.lamps.line, alone)


def switches_of(config: Config, cameras: Mapping[str, Camera], place: Path) -> Switches | None:
    """Return the switches of the glasses; None: there are none. Raises BadInputError that names ``place``."""
    if config.switches is None:
        return None
    if not isinstance(config.switches, CameraSwitchesSettings):
        from altd.devices.gpio.lamps import GpioSwitches

        return GpioSwitches(config.switches, [target.name for target in config.switched_targets])
    from altd.devices.camera_lamps import CameraSwitches

    camera_of = {target.name: target.camera for target in config.switched_targets}
    switching = {name: _switching(cameras, name, place, "switches") for name in camera_of.values()}
    return CameraSwitches(switching, camera_of, config.switches.line)


def _switching(cameras: Mapping[str, Camera], name: str, place: Path, table: str) -> SwitchingCamera:
    camera = cameras[name]
    if not isinstance(camera, SwitchingCamera):
        raise BadInputError(place, f"{table}: camera {name!r} has no output to switch")
    return camera


def indicators_of(config: Config) -> Indicators | None:
    """Return the indicator lamps of a config; None: it has none."""
    if config.indicators is None:
        return None
    from altd.devices.gpio.lamps import GpioIndicators

    return GpioIndicators(config.indicators)


def inclinometer_of(config: Config) -> tuple[Inclinometer, InclinometerSettings] | None:
    """Return the inclinometer of a config with its settings; None: it has none."""
    if config.inclinometer is None:
        return None
    from altd.devices.inclinometer.driver import ModbusInclinometer

    return ModbusInclinometer(config.inclinometer), config.inclinometer


def stage_of(config: Config, place: Path) -> Stage:
    """Return the stage of a config; raises BadInputError that names ``place``."""
    if config.stage is None:
        raise BadInputError(place, "stage: no [stage] table")
    from altd.devices.grbl.driver import GrblStage

    return GrblStage(config.stage)
