"""An open Video4Linux device: its descriptor, its own names, and the calls used by all other modules."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

from altd.devices.v4l2 import abi

CHARACTER_DEVICES = Path("/sys/dev/char")

Argument = TypeVar("Argument", bound=ctypes.Structure | ctypes.c_int)
Entry = TypeVar("Entry", bound=ctypes.Structure)


class VideoNode:
    """An open device. Every call may raise OSError; ENOTTY when it is not a Video4Linux device."""

    def __init__(self, path: Path) -> None:
        self.descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            about = self.call(abi.VIDIOC_QUERYCAP, abi.v4l2_capability())
        except OSError:
            self.close()
            raise
        self.driver = text(about.driver)
        self.card = text(about.card)
        self.serial = usb_serial(self.descriptor)
        capabilities = about.capabilities
        if capabilities & abi.V4L2_CAP_DEVICE_CAPS:  # those of this node, not of all nodes of the camera
            capabilities = about.device_caps
        captures = capabilities & (abi.V4L2_CAP_VIDEO_CAPTURE | abi.V4L2_CAP_VIDEO_CAPTURE_MPLANE)
        self.streams = bool(captures and capabilities & abi.V4L2_CAP_STREAMING)
        self.has_planes = captures == abi.V4L2_CAP_VIDEO_CAPTURE_MPLANE
        self.buffer_type = abi.V4L2_BUF_TYPE_VIDEO_CAPTURE
        if self.has_planes:
            self.buffer_type = abi.V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE

    def call(self, request: int, argument: Argument) -> Argument:
        """Let the kernel read and fill a structure; return it."""
        fcntl.ioctl(self.descriptor, request, argument)
        return argument

    def entries(self, request: int, argument: Entry) -> Iterator[Entry]:
        """Yield the entries of a kernel list by their ``index``, each in the same structure."""
        for index in range(1 << 16):
            argument.index = index
            try:
                yield self.call(request, argument)
            except OSError as error:
                if error.errno in (errno.EINVAL, errno.ENOTTY, errno.ENODATA):  # the end, or no such list
                    return
                raise

    def close(self) -> None:
        """Close the device; the kernel ends the stream and frees its buffers."""
        os.close(self.descriptor)


def usb_serial(descriptor: int) -> str | None:
    """Serial number in a USB camera's descriptor, from sysfs; None where it has none.

    ``device`` of the node is the camera's interface, its parent directory the USB device (sysfs-bus-usb).
    Some makers give all their cameras the same serial number.
    """
    number = os.fstat(descriptor).st_rdev
    interface = CHARACTER_DEVICES / f"{os.major(number)}:{os.minor(number)}" / "device"
    try:
        serial = (interface.resolve(strict=True).parent / "serial").read_text(errors="replace").strip()
    except OSError:
        return None
    return serial or None


def text(raw: bytes) -> str:
    """Decode a name from the kernel."""
    return raw.decode("utf-8", errors="replace").strip()
