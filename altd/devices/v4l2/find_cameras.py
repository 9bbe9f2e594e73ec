"""Discovery of Video4Linux cameras, with the values for ``altd.toml``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from altd.devices.v4l2.controls import Control, controls_of
from altd.devices.v4l2.image import PIXEL_FORMATS, Size, fourccs, sizes
from altd.devices.v4l2.node import VideoNode

_DEVICES = Path("/dev")
_BY_PATH = Path("/dev/v4l/by-path")


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
        grey = {
            name: tuple(sizes(node, known.fourcc))
            for name, known in PIXEL_FORMATS.items()
            if known.fourcc in there
        }
        return FoundCamera(path, node.card, node.driver, node.serial, grey, tuple(controls_of(node).values()))
    finally:
        node.close()
