"""Video4Linux cameras: USB and MIPI (docs/cameras.md)."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, get_args

from pydantic import Field

from altd.devices.settings import Driver, LiveCameraSettings
from altd.files.table import ControlValue, Device
from altd.ports import Camera, Clock

_PixelFormat = Literal["GREY", "Y10", "Y12", "Y16", "Y10P", "Y12P", "YUYV", "UYVY", "NV12", "MJPG"]
PIXEL_FORMAT_NAMES: tuple[str, ...] = get_args(_PixelFormat)
"""Names of the pixel formats that altd can use, best first."""


class V4l2CameraSettings(LiveCameraSettings):
    """A USB or MIPI camera through the kernel's Video4Linux."""

    about: ClassVar[Driver | None] = Driver(
        "altd.devices.v4l2.find_cameras",
        'Cameras: [cameras.NAME], driver = "v4l2"',
        ("camera", "/dev/video*"),
    )

    driver: Literal["v4l2"]
    device: Device
    """Device path, preferably a stable one such as /dev/v4l/by-path/… (`altd devices`)."""
    pixel_format: _PixelFormat = "GREY"
    """Grey of 8 to 16 bits, packed (`P`) or not; of a colour camera its luminance."""
    controls: dict[str, ControlValue] = Field(default={})
    """Controls to set when the camera is opened, by the names in `altd devices`, such as a trigger input."""

    def camera(self, name: str, clock: Clock, shared: dict[object, Any]) -> Camera:
        """Return the camera."""
        from altd.devices.v4l2.camera import V4l2Camera

        return V4l2Camera(name, self)
