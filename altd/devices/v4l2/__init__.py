"""Video4Linux cameras: USB and MIPI (docs/cameras.md)."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from altd.devices.settings import Driver, LiveCameraSettings
from altd.files.table import ControlValue, Device
from altd.ports import Camera, Clock


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
    pixel_format: Literal["GREY", "Y10", "Y12", "Y16"] = "GREY"
    """8, 10, 12 or 16 bits of grey."""
    controls: dict[str, ControlValue] = Field(default={})
    """Controls to set when the camera is opened, by the names in `altd devices`, such as a trigger input."""

    def camera(self, name: str, clock: Clock, shared: dict[object, Any]) -> Camera:
        """Return the camera."""
        from altd.devices.v4l2.camera import V4l2Camera

        return V4l2Camera(name, self)
