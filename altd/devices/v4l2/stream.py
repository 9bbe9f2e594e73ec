"""Frames of an open camera through buffers that the driver fills and this process maps."""

from __future__ import annotations

import ctypes
import errno
import select
import time
from fractions import Fraction
from mmap import mmap

from linuxpy.video.raw import (
    IOC,
    BufType,
    Capability,
    Memory,
    v4l2_buffer,
    v4l2_format,
    v4l2_fourcc,
    v4l2_requestbuffers,
    v4l2_streamparm,
)

from altd.devices.v4l2 import offers
from altd.devices.v4l2.image import Layout, PixelFormat
from altd.devices.v4l2.node import Node
from altd.ports import CameraRefusedError

_BUFFERS = 4
"""One is filled while one is taken; the others bridge a thread that the machine lets wait."""
_AGAIN_S = 0.001
_SAME_RATE = 1e-4
"""Rates that differ by less are one: a fraction of the kernel's, a decimal of the config."""


def set_format(node: Node, width: int, height: int, pixel_format: PixelFormat) -> Layout:
    """Have frames of exactly this format; raises CameraRefusedError that says what there is, or OSError."""
    wanted = v4l2_format(type=BufType.VIDEO_CAPTURE)
    wanted.fmt.pix.width = width
    wanted.fmt.pix.height = height
    wanted.fmt.pix.pixelformat = v4l2_fourcc(*pixel_format.fourcc)
    taken = node.call(IOC.S_FMT, wanted).fmt.pix
    if taken.pixelformat != v4l2_fourcc(*pixel_format.fourcc):
        there = ", ".join(fourcc.strip() for fourcc in offers.fourccs(node))
        raise CameraRefusedError(f"has no pixel format {pixel_format.name}; it has {there or 'none'}")
    if (taken.width, taken.height) != (width, height):
        there = ", ".join(map(str, offers.sizes(node, pixel_format.fourcc)))
        nearest = f"the nearest is {taken.width} × {taken.height}" + (f" of {there}" if there else "")
        raise CameraRefusedError(f"has no frames of {width} × {height} in {pixel_format.name}; {nearest}")
    layout = Layout(width, height, taken.bytesperline or width * pixel_format.bytes_per_pixel, pixel_format)
    if layout.frame_bytes > taken.sizeimage:
        raise CameraRefusedError(
            f"promises {layout.frame_bytes} bytes a frame in buffers of {taken.sizeimage}"
        )
    return layout


def set_rate(node: Node, fps: float, layout: Layout) -> None:
    """Have this rate, where the camera lets itself be set one; raises CameraRefusedError or OSError."""
    asked = v4l2_streamparm(type=BufType.VIDEO_CAPTURE)
    capture = asked.parm.capture
    try:
        node.call(IOC.G_PARM, asked)
        if not capture.capability & Capability.TIMEPERFRAME:
            return
        period = 1 / Fraction(fps).limit_denominator(100_000)
        capture.timeperframe.numerator = period.numerator
        capture.timeperframe.denominator = period.denominator
        node.call(IOC.S_PARM, asked)
    except OSError as error:
        if error.errno == errno.ENOTTY:
            return
        raise
    taken = capture.timeperframe
    rate = taken.denominator / taken.numerator if taken.numerator else 0.0
    if abs(rate - fps) > _SAME_RATE * fps:
        there = offers.rates(node, layout.pixel_format.fourcc, layout.width, layout.height)
        listed = " of " + ", ".join(f"{rate:.6g}" for rate in there) if there else ""
        raise CameraRefusedError(f"does not run at {fps:g} frames/s; the nearest is {rate:.6g}{listed}")


class Stream:
    """A running camera. Used from one thread; every method raises OSError when the camera is gone."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._poll = select.poll()
        self._poll.register(node.descriptor, select.POLLIN)
        self._maps: list[mmap] = []
        try:
            granted = node.call(
                IOC.REQBUFS,
                v4l2_requestbuffers(count=_BUFFERS, type=BufType.VIDEO_CAPTURE, memory=Memory.MMAP),
            )
            for index in range(granted.count):  # not always as many as were asked for
                buffer = node.call(IOC.QUERYBUF, _buffer(index))
                self._maps.append(mmap(node.descriptor, buffer.length, offset=buffer.m.offset))
                node.call(IOC.QBUF, buffer)
            node.call(IOC.STREAMON, ctypes.c_int(BufType.VIDEO_CAPTURE))
        except OSError:
            self.close()
            raise

    def take(self, deadline_s: float) -> v4l2_buffer | None:
        """The next buffer that the driver has filled, or None by the deadline of ``time.monotonic``."""
        while True:
            left_ms = max(0.0, deadline_s - time.monotonic()) * 1e3
            if not self._poll.poll(left_ms):
                return None
            try:
                return self._node.call(IOC.DQBUF, _buffer(0))
            except BlockingIOError:
                if left_ms <= 0.0:
                    return None
                time.sleep(_AGAIN_S)  # woken for nothing; a driver that does so for ever costs no processor

    def memory(self, buffer: v4l2_buffer) -> mmap:
        """What the driver wrote; its own again after ``give_back``."""
        return self._maps[int(buffer.index)]

    def give_back(self, buffer: v4l2_buffer) -> None:
        """Let the driver fill it again."""
        self._node.call(IOC.QBUF, buffer)

    def close(self) -> None:
        """Unmap the buffers; the stream ends when the node is closed."""
        while self._maps:
            self._maps.pop().close()


def _buffer(index: int) -> v4l2_buffer:
    return v4l2_buffer(index=index, type=BufType.VIDEO_CAPTURE, memory=Memory.MMAP)
