"""Discovery of Video4Linux cameras, with the values for ``altd.toml``; checks of those that it names."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from altd.devices.nodes import check_duplicates, check_node
from altd.devices.pixels import PIXEL_FORMATS
from altd.devices.settings import details
from altd.devices.v4l2 import PIXEL_FORMAT_NAMES, V4l2CameraSettings
from altd.devices.v4l2.controls import Control, automatic_modes, controls_of
from altd.devices.v4l2.image import Size, fourccs, sizes
from altd.devices.v4l2.node import VideoNode
from altd.process.machine import Finding, Machine

_DEVICES = Path("/dev")
_BY_PATH = Path("/dev/v4l/by-path")
_NAMES = ("/dev/v4l/by-path/*", "/dev/v4l/by-id/*", "/dev/video*")
_MAX_USB_SHARE = 0.6
"""Share of a USB's speed that is left for pictures: 80 % of the time, less its own frames and gaps."""


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """One camera: its path for ``device``, its own name, its grey formats with sizes, and its controls.

    ``path`` is the stable one where it exists; ``serial`` is that of a USB camera, None where it has none.
    Without a grey format altd cannot use the camera.
    """

    path: Path
    card: str
    driver: str
    serial: str | None
    formats: Mapping[str, tuple[Size, ...]]
    controls: tuple[Control, ...]


@dataclass(frozen=True, slots=True)
class UnreadableCamera:
    """A device that may be a camera, and why this is unknown."""

    path: Path
    why: str


def find_cameras() -> Iterator[FoundCamera | UnreadableCamera]:
    """Yield the cameras of this machine in the order of their numbers; none is reserved or changed."""
    stable = {path.resolve(): path for path in sorted(_BY_PATH.glob("*"), reverse=True)}
    for device in sorted(_DEVICES.glob("video[0-9]*"), key=lambda device: int(device.name[5:])):
        path = stable.get(device, device)
        try:
            found = _camera_at(device, path)
        except OSError as error:
            yield UnreadableCamera(path, error.strerror or "cannot be read")
        else:
            if found is not None:
                yield found


def _camera_at(device: Path, path: Path) -> FoundCamera | None:
    """Camera behind a device; None for another device, such as an output. Raises OSError."""
    node = VideoNode(device)
    try:
        if not node.streams:
            return None
        there = fourccs(node)
        grey = {name: tuple(sizes(node, name)) for name in PIXEL_FORMAT_NAMES if f"{name:<4}" in there}
        return FoundCamera(path, node.card, node.driver, node.serial, grey, tuple(controls_of(node).values()))
    finally:
        node.close()


def lines() -> Iterator[str]:
    """Yield the cameras of this machine for ``altd devices``."""
    cameras = list(find_cameras())
    serials = Counter(found.serial for found in cameras if isinstance(found, FoundCamera))
    for found in cameras:
        yield f'  device = "{found.path}"'
        if isinstance(found, UnreadableCamera):
            yield from details(f"cannot be read: {found.why}")
            continue
        yield from details(f"{found.card}, kernel driver {found.driver}")
        if found.serial is None:
            yield from details("no serial number: known by its port, the device above")
        elif serials[found.serial] > 1:
            same = f"serial number {found.serial}, as another camera"
            yield from details(f"{same}: known by its port, the device above")
        else:
            yield f'  serial = "{found.serial}"'
        for pixel_format, there in found.formats.items():
            yield from details(f'pixel_format = "{pixel_format}": {", ".join(map(str, there))}')
        if not found.formats:
            yield from details("sends no grey picture that altd can use")
        settable = [f"{c.name} {c.minimum} to {c.maximum}" for c in found.controls if c.writes]
        if settable:
            yield from details(f"controls: {', '.join(settable)}")


def check(cameras: Mapping[str, V4l2CameraSettings], machine: Machine) -> Iterator[Finding]:
    """Check the V4L2 cameras, and the USB buses that they are connected to."""
    needs_mbit_s: dict[str, float] = {}
    speeds: dict[str, int] = {}
    for name, camera in cameras.items():
        yield from check_node(f"camera {name} {camera.device}", camera.device, _NAMES, machine)
        yield from _automatic(f"camera {name} {camera.device}", camera, machine)
        has_port = _BY_PATH in camera.device.parents
        if camera.serial is None and not has_port and machine.status(camera.device) is not None:
            text = "names neither a port nor a serial: after a restart it may be another camera"
            remedy = f"ls -l {_BY_PATH}   # device = one of these"
            yield Finding.warning(f"camera {name} {camera.device}", text, remedy)
        bus = _usb_bus(camera.device, machine)
        if bus is not None:
            number, speeds[bus[0]] = bus
            bytes_px = PIXEL_FORMATS[camera.pixel_format].bytes_per_pixel
            needed = camera.width * camera.height * bytes_px * camera.fps * 8e-6
            needs_mbit_s[number] = needs_mbit_s.get(number, 0.0) + needed
    yield from check_duplicates("camera", {name: camera.device for name, camera in cameras.items()}, machine)
    for number, needed in needs_mbit_s.items():
        subject, speed = f"USB bus {number}", speeds[number]
        text = f"its cameras need {needed:.0f} Mbit/s of {speed}"
        if needed <= _MAX_USB_SHARE * speed:
            yield Finding.good(subject, text)
        else:
            remedy = "lsusb -t   # plug a camera into a faster socket of the computer, on a bus of its own"
            yield Finding.error(subject, f"{text}: too much", remedy)


def _automatic(subject: str, camera: V4l2CameraSettings, machine: Machine) -> Iterator[Finding]:
    """Find automatic modes that cannot be switched off: altd tries at the opening of the camera."""
    try:
        node = VideoNode(machine.at(camera.device))
    except OSError:
        return  # which has a finding of its own
    try:
        on = [mode for mode in automatic_modes(node, camera) if machine.runs_daemon() or not mode.writes]
        values = ", ".join(f"{mode.name} = {mode.value(node)}" for mode in on)
    finally:
        node.close()
    if on:
        remedy = f"controls = {{ {values} }}   # accepts it, for a camera that cannot do without"
        names = ", ".join(mode.name for mode in on)
        yield Finding.warning(subject, f"{names}: stays on, so the picture changes automatically", remedy)


def _usb_bus(device: Path, machine: Machine) -> tuple[str, int] | None:
    """Number of the USB bus of a camera and its speed in Mbit/s; None: it is not a USB camera."""
    status = machine.status(device)
    if status is None:
        return None
    number = f"{os.major(status.st_rdev)}:{os.minor(status.st_rdev)}"
    folder = machine.at(f"/sys/dev/char/{number}/device").resolve()
    for place in (folder, *folder.parents):
        if (place / "busnum").exists():
            try:
                return (place / "busnum").read_text().strip(), int(float((place / "speed").read_text()))
            except (OSError, ValueError):
                return None
    return None
