"""Frames of an open camera through buffers that the driver fills and this process maps."""

from __future__ import annotations

import ctypes
import errno
import math
import select
import time
from fractions import Fraction
from mmap import mmap

from altd.devices.v4l2 import abi
from altd.devices.v4l2.image import (
    Layout,
    PixelFormat,
    fourccs,
    rates,
    sizes,
)
from altd.devices.v4l2.node import VideoNode
from altd.ports import CameraRefusedError

_BUFFER_COUNT = 4
"""Number of buffers besides those of a stall: one is filled while one is taken."""
_STALL_S = 0.25
"""Longest delay of the process, as by another program, that loses no frame."""
_MAX_BUFFER_COUNT = 32
"""VIDEO_MAX_FRAME (linux/videodev2.h); the kernel grants fewer where memory is short."""
_SPURIOUS_WAKE_BACKOFF_S = 0.001
_RATE_TOLERANCE = 1e-4
"""Maximum relative difference of equal rates: the kernel uses fractions, the config decimals."""


def set_format(node: VideoNode, width: int, height: int, pixel_format: PixelFormat) -> Layout:
    """Set exactly this format; raises CameraRefusedError that lists the available ones, or OSError."""
    wanted = abi.v4l2_format(type=abi.V4L2_BUF_TYPE_VIDEO_CAPTURE)
    wanted.fmt.pix.width = width
    wanted.fmt.pix.height = height
    wanted.fmt.pix.pixelformat = abi.v4l2_fourcc(pixel_format.fourcc)
    taken = node.call(abi.VIDIOC_S_FMT, wanted).fmt.pix
    if taken.pixelformat != abi.v4l2_fourcc(pixel_format.fourcc):
        there = ", ".join(fourcc.strip() for fourcc in fourccs(node))
        raise CameraRefusedError(f"has no pixel format {pixel_format.name}; it has {there or 'none'}")
    if (taken.width, taken.height) != (width, height):
        there = ", ".join(map(str, sizes(node, pixel_format.fourcc)))
        nearest = f"the nearest is {taken.width} × {taken.height}" + (f" of {there}" if there else "")
        raise CameraRefusedError(f"has no frames of {width} × {height} in {pixel_format.name}; {nearest}")
    layout = Layout(width, height, taken.bytesperline or width * pixel_format.bytes_per_pixel, pixel_format)
    if layout.frame_bytes > taken.sizeimage:
        raise CameraRefusedError(
            f"promises {layout.frame_bytes} bytes a frame in buffers of {taken.sizeimage}"
        )
    return layout


def set_rate(node: VideoNode, fps: float, layout: Layout) -> None:
    """Set this rate where the camera allows it; raises CameraRefusedError or OSError."""
    asked = abi.v4l2_streamparm(type=abi.V4L2_BUF_TYPE_VIDEO_CAPTURE)
    capture = asked.parm.capture
    try:
        node.call(abi.VIDIOC_G_PARM, asked)
        if not capture.capability & abi.V4L2_CAP_TIMEPERFRAME:
            return
        period = 1 / Fraction(fps).limit_denominator(100_000)
        capture.timeperframe.numerator = period.numerator
        capture.timeperframe.denominator = period.denominator
        node.call(abi.VIDIOC_S_PARM, asked)
    except OSError as error:
        if error.errno == errno.ENOTTY:
            return
        raise
    taken = capture.timeperframe
    rate = taken.denominator / taken.numerator if taken.numerator else 0.0
    if abs(rate - fps) > _RATE_TOLERANCE * fps:
        there = rates(node, layout.pixel_format.fourcc, layout.width, layout.height)
        listed = " of " + ", ".join(f"{rate:.6g}" for rate in there) if there else ""
        raise CameraRefusedError(f"does not run at {fps:g} frames/s; the nearest is {rate:.6g}{listed}")


class Stream:
    """A running camera, used from one thread; every method raises OSError when the camera is gone."""

    def __init__(self, node: VideoNode, fps: float) -> None:
        self._node = node
        wanted = min(_BUFFER_COUNT + math.ceil(fps * _STALL_S), _MAX_BUFFER_COUNT)
        self._poll = select.poll()
        self._poll.register(node.descriptor, select.POLLIN)
        self._maps: list[mmap] = []
        try:
            granted = node.call(
                abi.VIDIOC_REQBUFS,
                abi.v4l2_requestbuffers(
                    count=wanted, type=abi.V4L2_BUF_TYPE_VIDEO_CAPTURE, memory=abi.V4L2_MEMORY_MMAP
                ),
            )
            for index in range(granted.count):  # may differ from the number requested
                buffer = node.call(abi.VIDIOC_QUERYBUF, _buffer(index))
                self._maps.append(mmap(node.descriptor, buffer.length, offset=buffer.m.offset))
                stamp = buffer.flags & abi.V4L2_BUF_FLAG_TIMESTAMP_MASK
                if index < _BUFFER_COUNT or stamp == abi.V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC:
                    node.call(abi.VIDIOC_QBUF, buffer)  # other frames are stamped on arrival: few may wait
            node.call(abi.VIDIOC_STREAMON, ctypes.c_int(abi.V4L2_BUF_TYPE_VIDEO_CAPTURE))
        except OSError:
            self.close()
            raise

    def take(self, deadline_s: float) -> abi.v4l2_buffer | None:
        """Return the next buffer filled by the driver, or None at the deadline of ``time.monotonic``."""
        while True:
            left_ms = max(0.0, deadline_s - time.monotonic()) * 1e3
            if not self._poll.poll(left_ms):
                return None
            try:
                return self._node.call(abi.VIDIOC_DQBUF, _buffer(0))
            except BlockingIOError:
                if left_ms <= 0.0:
                    return None
                # spurious wake; a driver that repeats it must not occupy a whole core
                time.sleep(_SPURIOUS_WAKE_BACKOFF_S)

    def memory(self, buffer: abi.v4l2_buffer) -> mmap:
        """Bytes that the driver wrote; they are the driver's again after ``requeue``."""
        return self._maps[int(buffer.index)]

    def requeue(self, buffer: abi.v4l2_buffer) -> None:
        """Return the buffer to the driver, which fills it again."""
        self._node.call(abi.VIDIOC_QBUF, buffer)

    def close(self) -> None:
        """Unmap the buffers; the stream ends when the node is closed."""
        while self._maps:
            self._maps.pop().close()


def _buffer(index: int) -> abi.v4l2_buffer:
    return abi.v4l2_buffer(index=index, type=abi.V4L2_BUF_TYPE_VIDEO_CAPTURE, memory=abi.V4L2_MEMORY_MMAP)
