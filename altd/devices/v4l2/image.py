"""Formats of a V4L2 camera, and conversion of its buffers to grey values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, auto
from typing import Literal

from altd.devices.pixels import PixelFormat
from altd.devices.v4l2 import abi
from altd.devices.v4l2.node import VideoNode
from altd.records import PixelArray


@dataclass(frozen=True, slots=True)
class Size:
    """Columns × rows, or a range of them."""

    width: int
    height: int
    max_width: int
    max_height: int

    def __str__(self) -> str:
        smallest = f"{self.width} × {self.height}"
        if (self.width, self.height) == (self.max_width, self.max_height):
            return smallest
        return f"{smallest} to {self.max_width} × {self.max_height}"


def fourccs(node: VideoNode) -> list[str]:
    """Pixel formats of the camera by their four characters; raises OSError."""
    asked = abi.v4l2_fmtdesc(type=node.buffer_type)
    return [_characters(entry.pixelformat) for entry in node.entries(abi.VIDIOC_ENUM_FMT, asked)]


def sizes(node: VideoNode, pixel_format: str) -> list[Size]:
    """Frame sizes in a format; raises OSError."""
    asked = abi.v4l2_frmsizeenum(pixel_format=code(pixel_format))
    return [_size(entry) for entry in node.entries(abi.VIDIOC_ENUM_FRAMESIZES, asked)]


def rates(node: VideoNode, pixel_format: str, width: int, height: int) -> list[float]:
    """Rates of such frames, frames/s, or the ends of their range; raises OSError."""
    asked = abi.v4l2_frmivalenum(pixel_format=code(pixel_format), width=width, height=height)
    found = [rate for entry in node.entries(abi.VIDIOC_ENUM_FRAMEINTERVALS, asked) for rate in _rates(entry)]
    return sorted(set(found))


def _size(entry: abi.v4l2_frmsizeenum) -> Size:
    if entry.type == abi.V4L2_FRMSIZE_TYPE_DISCRETE:
        only = entry.discrete
        return Size(only.width, only.height, only.width, only.height)
    range_ = entry.stepwise
    return Size(range_.min_width, range_.min_height, range_.max_width, range_.max_height)


def _rates(entry: abi.v4l2_frmivalenum) -> Iterator[float]:
    discrete = entry.type == abi.V4L2_FRMIVAL_TYPE_DISCRETE
    periods = (entry.discrete,) if discrete else (entry.stepwise.min, entry.stepwise.max)
    for period in periods:
        if period.numerator:
            yield period.denominator / period.numerator


def _characters(number: int) -> str:
    """Fourcc as text; its highest bit marks big-endian."""
    plain = (number & 0x7FFFFFFF).to_bytes(4, "little").decode("latin-1")
    return plain + ("-BE" if number >> 31 else "")


_MAX_CLOCK_DIFFERENCE_NS = 1_000_000_000


def code(pixel_format: str) -> int:
    """Number of a pixel format from its name in ``altd.toml``: its characters, padded to four."""
    return abi.v4l2_fourcc(f"{pixel_format:<4}")


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a frame in a buffer; a line may be followed by padding."""

    width: int
    height: int
    bytes_per_line: int
    pixel_format: PixelFormat

    @property
    def frame_bytes(self) -> int:
        """Least size of a whole frame."""
        return self.pixel_format.frame_bytes(self.width, self.height, self.bytes_per_line)

    def pixels(self, data: memoryview) -> PixelArray:
        """Copy the grey values (rows, columns) of a frame, read-only; raises ValueError: it is damaged."""
        return self.pixel_format.pixels(data, self.width, self.height, self.bytes_per_line, is_lent=True)


class Stamp(Enum):
    """Meaning of a driver's time stamp: the exposure begins, or the last pixel has arrived."""

    START_OF_EXPOSURE = auto()
    END_OF_FRAME = auto()


def middle_of_exposure_ns(
    stamp_ns: int,
    clock: Literal["monotonic", "unknown"],
    source: Stamp,
    exposure_ms: float | None,
    now_ns: int,
) -> int:
    """Middle of an exposure on the monotonic clock, as exactly as the driver allows.

    A stamp of an unknown clock is taken as monotonic when it is less than a second from ``now_ns``. Otherwise
    ``now_ns``, the time when the frame was taken from the driver, replaces it. Half of the exposure is added
    to its start or subtracted from its end; an unknown exposure counts as zero. The exposure of a rolling
    shutter is that of all rows. A stamp of the second kind includes the readout time of a global shutter,
    which remains: no driver reports it.
    """
    if clock == "unknown" and abs(stamp_ns - now_ns) > _MAX_CLOCK_DIFFERENCE_NS:
        stamp_ns = now_ns
    half_ns = round((exposure_ms or 0.0) * 0.5e6)
    return stamp_ns + half_ns if source is Stamp.START_OF_EXPOSURE else stamp_ns - half_ns
