"""Common parts of programs in the guest: cameras, their controls by v4l2-ctl, and results of calls."""

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from altd.devices.v4l2 import V4l2CameraSettings
from altd.devices.v4l2.camera import V4l2Camera
from altd.ports import CameraError

VIDEO = Path("/sys/class/video4linux")


def nodes(name_contains: str) -> list[Path]:
    """The device nodes whose driver's name for them contains this, by number."""
    found = [node for node in VIDEO.iterdir() if name_contains in (node / "name").read_text()]
    return [Path("/dev", node.name) for node in sorted(found, key=lambda node: int(node.name[5:]))]


def plug_in(place: str, node: Path) -> Path:
    """Name a node by the place where it is plugged in, as udev would; returns the stable path."""
    path = Path("/dev/v4l/by-path", place)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(node)
    return path


def v4l2_ctl(device: Path, *arguments: str) -> str:
    """Run the foreign tool on a device; returns what it prints."""
    done = subprocess.run(["v4l2-ctl", "-d", device, *arguments], capture_output=True, text=True, check=True)
    return done.stdout


def camera(device: Path, **settings: object) -> V4l2Camera:
    """A camera of vivid's or v4l2loopback's, 640 × 360 at 25 frames a second unless told otherwise.

    vivid counts time in the guest's ticks of 10 ms: of other rates it makes steps of two lengths.
    """
    table = {"driver": "v4l2", "device": device, "width": 640, "height": 360, "fps": 25, **settings}
    return V4l2Camera("front", V4l2CameraSettings.model_validate(table))


def outcome(call: Callable[[], object]) -> dict[str, object]:
    """The result of a call: the kind of its error, its sentence, and its duration."""
    began_s = time.monotonic()
    error, message = "", ""
    try:
        call()
    except CameraError as raised:
        error, message = type(raised).__name__, str(raised)
    return {"error": error, "message": message, "seconds": time.monotonic() - began_s}
