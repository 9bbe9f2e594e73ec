"""Frames of an open camera through buffers that the driver fills and this process maps."""

from __future__ import annotations

import ctypes
import errno
import math
import select
import time
from fractions import Fraction
from mmap import mmap

from altd.devices.pixels import PixelFormat
from altd.devices.v4l2 import abi
from altd.devices.v4l2.image import Layout, code, fourccs, rates, sizes
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
    try:
        line_bytes = pixel_format.line_bytes(width)
    except ValueError as error:
        raise CameraRefusedError(str(error)) from None
    wanted = abi.v4l2_format(type=node.buffer_type)
    taken = wanted.fmt.pix_mp if node.has_planes else wanted.fmt.pix
    taken.width, taken.height, taken.pixelformat = width, height, code(pixel_format.name)
    node.call(abi.VIDIOC_S_FMT, wanted)
    plane = taken.plane_fmt[0] if node.has_planes else taken
    if taken.pixelformat != code(pixel_format.name) or (node.has_planes and taken.num_planes != 1):
        there = ", ".join(fourcc.strip() for fourcc in fourccs(node))
        raise CameraRefusedError(f"has no pixel format {pixel_format.name}; it has {there or 'none'}")
    if (taken.width, taken.height) != (width, height):
        there = ", ".join(map(str, sizes(node, pixel_format.name)))
        nearest = f"the nearest is {taken.width} × {taken.height}" + (f" of {there}" if there else "")
        raise CameraRefusedError(f"has no frames of {width} × {height} in {pixel_format.name}; {nearest}")
    layout = Layout(width, height, plane.bytesperline or line_bytes, pixel_format)
    if layout.bytes_per_line < line_bytes:
        raise CameraRefusedError(f"promises {layout.bytes_per_line} bytes a line of {line_bytes}")
    if layout.frame_bytes > plane.sizeimage:
        raise CameraRefusedError(
            f"promises {layout.frame_bytes} bytes a frame in buffers of {plane.sizeimage}"
        )
    return layout


def set_rate(node: VideoNode, fps: float, layout: Layout) -> None:
    """Set this rate where the camera allows it; raises CameraRefusedError or OSError."""
    asked = abi.v4l2_streamparm(type=node.buffer_type)
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
        there = rates(node, layout.pixel_format.name, layout.width, layout.height)
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
                abi.v4l2_requestbuffers(count=wanted, type=node.buffer_type, memory=abi.V4L2_MEMORY_MMAP),
            )
            for index in range(granted.count):  # may differ from the number requested
                buffer = node.call(abi.VIDIOC_QUERYBUF, self._buffer(index))
                plane = _plane(buffer) if node.has_planes else None
                length, offset = (
                    (plane.length, plane.m.mem_offset) if plane else (buffer.length, buffer.m.offset)
                )
                self._maps.append(mmap(node.descriptor, length, offset=offset))
                stamp = buffer.flags & abi.V4L2_BUF_FLAG_TIMESTAMP_MASK
                if index < _BUFFER_COUNT or stamp == abi.V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC:
                    node.call(abi.VIDIOC_QBUF, buffer)  # other frames are stamped on arrival: few may wait
            node.call(abi.VIDIOC_STREAMON, ctypes.c_int(node.buffer_type))
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
                return self._node.call(abi.VIDIOC_DQBUF, self._buffer(0))
            except BlockingIOError:
                if left_ms <= 0.0:
                    return None
                # spurious wake; a driver that repeats it must not occupy a whole core
                time.sleep(_SPURIOUS_WAKE_BACKOFF_S)

    def data(self, buffer: abi.v4l2_buffer) -> memoryview:
        """Bytes that the driver wrote; they are the driver's again after ``requeue``. Release them first."""
        written, begin = int(buffer.bytesused), 0
        if self._node.has_planes:
            plane = _plane(buffer)
            written, begin = int(plane.bytesused), int(plane.data_offset)
        return memoryview(self._maps[int(buffer.index)])[begin:written]

    def requeue(self, buffer: abi.v4l2_buffer) -> None:
        """Return the buffer to the driver, which fills it again."""
        self._node.call(abi.VIDIOC_QBUF, buffer)

    def close(self) -> None:
        """Unmap the buffers; the stream ends when the node is closed."""
        while self._maps:
            self._maps.pop().close()

    def _buffer(self, index: int) -> abi.v4l2_buffer:
        buffer = abi.v4l2_buffer(index=index, type=self._node.buffer_type, memory=abi.V4L2_MEMORY_MMAP)
        if self._node.has_planes:
            buffer.m.planes = ctypes.pointer(abi.v4l2_plane())
            buffer.length = 1
        return buffer


def _plane(buffer: abi.v4l2_buffer) -> abi.v4l2_plane:
    """Its only plane."""
    plane: abi.v4l2_plane = buffer.m.planes[0]
    return plane
