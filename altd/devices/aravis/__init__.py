"""GigE Vision and USB3 Vision cameras through Aravis."""

from __future__ import annotations

import ipaddress
import re
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import AfterValidator, Field, model_validator

from altd.devices.settings import Driver, LiveCameraSettings
from altd.devices.trigger_times import TriggerTimes
from altd.errors import BadInputError
from altd.files.table import Celsius, ControlValue, complaint, shown
from altd.ports import Camera, Clock
from altd.process.addresses import is_unassignable
from altd.process.machine import Finding, said

DEBIAN_GI = Path("/usr/lib/python3/dist-packages/gi")
"""PyGObject of Debian's package python3-gi, which a virtual environment hides."""


def remedy_of(error: Exception) -> str:
    """Return what helps after ``error`` of importing gi, or of loading Aravis' typelib with it."""
    if isinstance(error, ValueError):  # gi is there, the typelib is not
        return "sudo apt-get install gir1.2-aravis-0.8"
    if isinstance(error, ImportError) and error.name == "gi" and DEBIAN_GI.is_dir():
        return (
            "this Python does not see the installed python3-gi: make its environment with "
            "/usr/bin/python3 -m venv --system-site-packages, or pip install 'altd[aravis]' in it"
        )
    return "sudo apt-get install python3-gi gir1.2-aravis-0.8"


def _library(needed: bool) -> Finding:
    """Check PyGObject and Aravis' typelib; only cameras of driver "aravis" need them."""
    subject = "library aravis"
    try:
        gi = import_module("gi")
        gi.require_version("Aravis", "0.8")
        import_module("gi.repository.Aravis")
    except Exception as error:
        text = f"GigE Vision and USB3 Vision cameras need it: {said(error)}"
        remedy = f"{remedy_of(error)}   # see docs/cameras.md"
        return (Finding.error if needed else Finding.warning)(subject, text, remedy)
    return Finding.good(subject, "installed")


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


_PixelFormat = Literal[
    "Mono8", "Mono10", "Mono12", "Mono16", "Mono10p", "Mono12p", "Mono10Packed", "Mono12Packed"
]
PIXEL_FORMAT_NAMES: tuple[str, ...] = get_args(_PixelFormat)
"""Names of the pixel formats that altd can use."""


class AravisCameraSettings(LiveCameraSettings):
    """A GigE Vision or USB3 Vision camera through Aravis. Needs the packages that `cameras.md` names."""

    about: ClassVar[Driver | None] = Driver(
        "altd.devices.aravis.check",
        'Cameras: [cameras.NAME], driver = "aravis"',
        library=_library,
    )
    has_outputs: ClassVar[bool] = True

    driver: Literal["aravis"]
    device: Annotated[str, Field(min_length=1, max_length=128), AfterValidator(_camera_name)]
    """Serial number or id; of GigE Vision also IP address or user-defined name (`altd devices`)."""
    interface: Literal["gige", "usb"] = "gige"
    """GigE Vision or USB3 Vision; `packet_bytes` and `resend` are for GigE Vision alone."""
    pixel_format: _PixelFormat = "Mono8"
    """Grey of 8 to 16 bits, packed (`p`, `Packed`) or not."""
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

    @model_validator(mode="after")
    def _check_interface(self) -> Self:
        keys = sorted({"packet_bytes", "resend"} & self.model_fields_set)
        if self.interface == "usb" and keys:
            raise complaint(*(((key,), 'is for interface = "gige" alone') for key in keys))
        return self

    @property
    def trigger_input(self) -> str | None:
        """Input line whose signal triggers the camera."""
        return self.trigger_line if self.trigger == "line" else None

    @property
    def software_triggered(self) -> bool:
        """Whether altd triggers the camera, together with all others of this kind."""
        return self.trigger == "software"

    @property
    def celsius_limits(self) -> tuple[float, float] | None:
        """Limits of the temperature inside, °C."""
        return self.min_celsius, self.max_celsius

    def camera(self, name: str, clock: Clock, shared: dict[object, Any]) -> Camera:
        """Return the camera; raises BadInputError if Aravis is missing."""
        try:
            from altd.devices.aravis.driver import AravisCamera, UsbCamera
        except ImportError as error:
            raise BadInputError(f"cameras.{name}", str(error)) from error
        kind = UsbCamera if self.interface == "usb" else AravisCamera
        if not self.software_triggered:
            return kind(name, self)
        triggers = shared.setdefault(TriggerTimes, TriggerTimes(round(1e9 / self.fps), 0))
        triggers.lengthen(round(1e6 * self.busy_ms))
        return kind(name, self, triggers)
