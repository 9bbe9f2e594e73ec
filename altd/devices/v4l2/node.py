"""An open Video4Linux device: its descriptor, its own names, and the calls that all else is made of."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol, TypeVar

from linuxpy.video.raw import IOC, Capability, v4l2_capability

_CHARACTER_DEVICES = Path("/sys/dev/char")

CallStruct = TypeVar("CallStruct")


class Indexed(Protocol):
    """A structure of the kernel that asks for one entry of a list."""

    index: int


Entry = TypeVar("Entry", bound=Indexed)


class Node:
    """Raises OSError, as every call does; ENOTTY when this is no Video4Linux device."""

    def __init__(self, path: Path) -> None:
        self.descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            about = self.call(IOC.QUERYCAP, v4l2_capability())
        except OSError:
            self.close()
            raise
        self.driver = text(about.driver)
        self.card = text(about.card)
        self.bus = text(about.bus_info)
        self.serial = _usb_serial(self.descriptor)
        capabilities = Capability(about.capabilities)
        if Capability.DEVICE_CAPS in capabilities:  # those of this node, not of all nodes of the camera
            capabilities = Capability(about.device_caps)
        self.streams = Capability.VIDEO_CAPTURE in capabilities and Capability.STREAMING in capabilities

    def call(self, request: int, argument: CallStruct) -> CallStruct:
        """Let the kernel read and fill a structure, which comes back."""
        fcntl.ioctl(self.descriptor, request, argument)  # type: ignore[call-overload]
        return argument

    def entries(self, request: int, argument: Entry) -> Iterator[Entry]:
        """The entries of one of the kernel's lists, each in the same structure."""
        for index in range(1 << 16):
            argument.index = index
            try:
                yield self.call(request, argument)
            except OSError as error:
                if error.errno in (errno.EINVAL, errno.ENOTTY, errno.ENODATA):  # the end, or no such list
                    return
                raise

    def close(self) -> None:
        """Let go; the kernel ends the stream and frees its buffers."""
        os.close(self.descriptor)


def _usb_serial(descriptor: int) -> str | None:
    """The serial number in a USB camera's descriptor, from sysfs; None where it has none.

    ``device`` of the node is the camera's interface, the directory above it the USB device (sysfs-bus-usb).
    Some makers give all their cameras the same.
    """
    number = os.fstat(descriptor).st_rdev
    interface = _CHARACTER_DEVICES / f"{os.major(number)}:{os.minor(number)}" / "device"
    try:
        serial = (interface.resolve(strict=True).parent / "serial").read_text(errors="replace").strip()
    except OSError:
        return None
    return serial or None


def text(raw: bytes) -> str:
    """A name of the kernel's as text."""
    return raw.decode("utf-8", errors="replace").strip()
