"""The parts required by a config, each behind its port; a driver is imported only if used."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from altd.acquisition.auto_exposure.control import ExposureControl
from altd.app.baseline import baseline_file
from altd.app.level import alignment_of
from altd.calibration.file import check_camera, check_image_size, check_place, load_calibration, target_of
from altd.calibration.planar_file import check_planar_camera, load_planar_calibration
from altd.config import Config, LiveCameraSettings
from altd.devices.playback import RecordingCameraSettings
from altd.devices.playback.player import PlaybackCamera
from altd.errors import BadInputError
from altd.files.reading import check_rights
from altd.instruments.planar.instrument import PlanarCalibration
from altd.measuring.calibration import Calibration
from altd.ports import Camera, Lamps, Switches
from altd.recording.header import LedPlateHeader
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
    if config.inclinometer is not None and config.inclinometer.level is not None:
        named.append(MissingFile("inclinometer.level", config.inclinometer.level, "altd level"))
    return [file for file in named if not os.path.lexists(file.path)]


def check_files(config: Config) -> tuple[AnyCalibration | None, list[BadInputError]]:
    """Return the calibration (None: unusable or missing) and the errors of the existing files of a config."""
    missing = {file.path for file in missing_files(config)}
    cameras: dict[str, Camera] = {}
    errors: dict[str, BadInputError] = {}
    shared: dict[object, Any] = {}
    for name, settings in config.cameras.items():
        if isinstance(settings, RecordingCameraSettings) and settings.path not in missing:
            try:
                cameras[name] = settings.camera(name, SystemClock(), shared)
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
    checks: list[Callable[[], object]] = list(interface_checks(config))
    if (of := config.inclinometer) is not None and of.level not in missing:
        checks.append(partial(alignment_of, of, config.unit.serial))
    for check in checks:
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
    clock, shared = SystemClock(), dict[object, Any]()
    return {name: config.cameras[name].camera(name, clock, shared) for name in config.measuring_cameras}


def calibration_of(config: Config, cameras: Mapping[str, Camera]) -> Calibration:
    """Load the config's calibration and check its unit, targets and cameras; raises BadInputError."""
    path = config.unit.calibration
    check_rights(path)
    calibration = load_calibration(path, config.unit.serial)
    if config.installation.expansion.is_corrected and calibration.temperature_c is None:
        text = "temperature_c is not stated, and [installation.expansion] corrects from it"
        raise BadInputError(path, text)
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
    return None if config.lamps is None else config.lamps.lamps(cameras, place, alone)


def switches_of(config: Config, cameras: Mapping[str, Camera], place: Path) -> Switches | None:
    """Return the switches of the glasses; None: there are none. Raises BadInputError that names ``place``."""
    camera_of = {target.name: target.camera for target in config.switched_targets}
    return None if config.switches is None else config.switches.switches(camera_of, cameras, place)
