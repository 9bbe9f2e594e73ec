"""The tables below ``[cameras]``."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from altd.config.addresses import is_unassignable
from altd.config.table import Celsius, ControlValue, Device, Table, complaint, shown


def _camera_name(name: str) -> str:
    """Accept any name of a GigE Vision camera; if it has the form of an IP address, it must be valid."""
    if re.fullmatch(r"[0-9]+(\.[0-9]+){3}", name):
        try:
            address = ipaddress.IPv4Address(name)
        except ValueError as error:
            raise complaint(((), f"{shown(name)} is not an IP address")) from error
        if address.is_multicast or address.is_unspecified or is_unassignable(address):
            raise complaint(((), f"{shown(name)} is an address that no camera has"))
    return name


READOUT_SHARE = 0.1
"""Share of the time between two frames that a camera may need in addition to the exposure."""


class RecordingCameraSettings(Table):
    """A camera that plays a recording; every output is marked ``playback``."""

    driver: Literal["recording"]
    path: Path
    """Folder of the recording."""
    pace: Literal["realtime", "fast"] = "realtime"
    """``realtime`` keeps the recording's times, ``fast`` does not wait."""
    repeat: bool = False
    """Start again at the end."""


class ExposureSettings(Table):
    """Exposure and gain of one camera."""

    control: Literal["auto", "fixed", "camera"] = "auto"
    """``auto`` controls the spot's peak; ``fixed`` sets ``exposure_ms`` and ``gain_db``; ``camera`` sets
    nothing."""
    exposure_ms: Annotated[float, Field(gt=0, le=1000)] = 2.0
    """Exposure time, ms: initial value of ``auto``, or ``fixed`` value. `altd record` and `altd scan` use it
    for both."""
    gain_db: Annotated[float, Field(ge=0, le=48)] = 0.0
    """Initial gain of ``auto``, or the ``fixed`` one, dB."""
    shortest_ms: Annotated[float, Field(gt=0, le=1000)] = 0.02
    """Lower limit of the exposure time of ``auto``, ms."""
    longest_ms: Annotated[float, Field(gt=0, le=1000)] = 20.0
    """Upper limit of the exposure time of ``auto``, ms, also 90 % of the frame interval. Long exposures smear
    vibration."""
    largest_gain_db: Annotated[float, Field(ge=0, le=48)] = 12.0
    """Upper limit of the gain of ``auto``, dB; ``auto`` adds gain only at ``longest_ms``."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.control != "auto":
            return self
        faults: list[tuple[tuple[str], str]] = []
        if not self.shortest_ms <= self.exposure_ms <= self.longest_ms:
            limits = f"from shortest_ms {self.shortest_ms:g} to longest_ms {self.longest_ms:g}"
            faults.append(
                (("exposure_ms",), f"{self.exposure_ms:g} is not where auto may begin; possible: {limits}")
            )
        if self.gain_db > self.largest_gain_db:
            limits = f"up to largest_gain_db {self.largest_gain_db:g}"
            faults.append((("gain_db",), f"{self.gain_db:g} is not where auto may begin; possible: {limits}"))
        if faults:
            raise complaint(*faults)
        return self


class LiveCameraSettings(Table):
    """Keys of all live cameras."""

    device: Path | str
    """Camera to open; its form depends on the driver."""
    width: Annotated[int, Field(ge=64, le=16384)] = 752
    """Columns of a frame, as in the calibration."""
    height: Annotated[int, Field(ge=64, le=16384)] = 480
    """Rows of a frame."""
    fps: Annotated[float, Field(ge=1, le=1000)] = 20.0
    """Frames per second."""
    exposure: ExposureSettings = ExposureSettings()
    """Exposure and gain, a separate table (below)."""
    serial: Annotated[str, Field(min_length=1, max_length=64)] | None = None
    """The camera's serial number (`altd devices`). Another camera is ``wrong_camera``."""

    @property
    def longest_exposure_ms(self) -> float:
        """Longest exposure time that the settings allow, ms; assumed if the camera controls it."""
        exposure = self.exposure
        if exposure.control == "fixed":
            return exposure.exposure_ms
        return min(exposure.longest_ms, (1 - READOUT_SHARE) * 1000 / self.fps)

    @property
    def busy_ms(self) -> float:
        """Longest time from a trigger until the camera can take the next, ms."""
        return self.longest_exposure_ms + READOUT_SHARE * 1000 / self.fps


class V4l2CameraSettings(LiveCameraSettings):
    """A USB or MIPI camera through the kernel's Video4Linux."""

    driver: Literal["v4l2"]
    device: Device
    """Device path, preferably a stable one such as /dev/v4l/by-path/… (`altd devices`)."""
    pixel_format: Literal["GREY", "Y10", "Y12", "Y16"] = "GREY"
    """8, 10, 12 or 16 bits of grey."""
    controls: dict[str, ControlValue] = Field(default={})
    """Controls to set when the camera is opened, by the names in `altd devices`, such as a trigger input."""


class AravisCameraSettings(LiveCameraSettings):
    """A GigE Vision camera through Aravis."""

    driver: Literal["aravis"]
    device: Annotated[str, Field(min_length=1, max_length=128), AfterValidator(_camera_name)]
    """Serial number, IP address, id or user-defined name (`altd devices`)."""
    pixel_format: Literal["Mono8", "Mono10", "Mono12", "Mono16"] = "Mono8"
    """8, 10, 12 or 16 bits of grey."""
    offset_x_px: Annotated[int, Field(ge=0, le=16384)] = 0
    """First column and row of the sensor, as in the calibration."""
    offset_y_px: Annotated[int, Field(ge=0, le=16384)] = 0
    trigger: Literal["free", "software", "line"] = "free"
    """``free``: the camera's own rate; ``software``: altd triggers all such cameras at once; ``line``: a
    signal at ``trigger_line``."""
    trigger_line: Annotated[str, Field(min_length=1, max_length=64)] = "Line1"
    """The camera's name of its trigger input."""
    packet_bytes: Annotated[int, Field(ge=0, le=16384)] = 0
    """Size of a network packet, bytes; 0 uses the largest possible."""
    resend: bool = True
    """Request lost packets again."""
    features: dict[str, bool | ControlValue | float | str] = Field(default={})
    """GenICam features to set when the camera is opened, in this order."""
    min_celsius: Celsius = -10.0
    """Temperature inside the camera below which the unit is out of specification, °C."""
    max_celsius: Celsius = 60.0
    """Temperature inside the camera above which the unit is out of specification, °C."""


AnyCameraSettings = Annotated[
    RecordingCameraSettings | V4l2CameraSettings | AravisCameraSettings, Field(discriminator="driver")
]


def software_triggered(cameras: Mapping[str, Table]) -> dict[str, AravisCameraSettings]:
    """Return the cameras that altd triggers, by name."""
    aravis = {name: camera for name, camera in cameras.items() if isinstance(camera, AravisCameraSettings)}
    return {name: camera for name, camera in aravis.items() if camera.trigger == "software"}
