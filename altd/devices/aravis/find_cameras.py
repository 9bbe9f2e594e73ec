"""Which GigE Vision cameras there are, without disturbing one that is in use."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from altd.devices.aravis import gvcp
from altd.devices.aravis.binding import Device
from altd.devices.aravis.gvcp import DiscoveredCamera
from altd.devices.aravis.open_camera import BITS
from altd.ports import CameraError

_DISCOVERY_TIMEOUT_S = 0.5
_ANSWER_TIMEOUT_S = 0.2


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera as the config wants it named: by serial number, address or id.

    ``in_use``: a program controls it. Its formats are then not known, for they are read from an open camera,
    and Aravis takes control of one that it opens. ``formats`` holds those that altd can use; None: not known.
    """

    id: str
    vendor: str
    model: str
    serial: str
    address: str
    in_use: bool
    formats: tuple[str, ...] | None


def find_cameras() -> list[FoundCamera]:
    """All cameras that answer in half a second, by address; one without a controller is opened shortly."""
    return [_examined(camera) for camera in gvcp.discover(_DISCOVERY_TIMEOUT_S)]


def _examined(camera: DiscoveredCamera) -> FoundCamera:
    in_use = gvcp.control_privilege(camera.address, _ANSWER_TIMEOUT_S) != 0
    formats = None
    if not in_use:
        with suppress(CameraError, OSError):
            device = Device(gvcp.own_address_towards(camera.address), camera.address)
            try:
                formats = tuple(name for name in device.choices("PixelFormat") if name in BITS)
            finally:
                device.close()
    return FoundCamera(camera.id, camera.vendor, camera.model, camera.serial, camera.address, in_use, formats)
