"""What frames a camera offers: pixel formats, sizes, rates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from altd.devices.v4l2 import abi
from altd.devices.v4l2.node import Node


@dataclass(frozen=True, slots=True)
class Size:
    """Columns × rows, or a whole range of them."""

    width: int
    height: int
    max_width: int
    max_height: int

    def __str__(self) -> str:
        smallest = f"{self.width} × {self.height}"
        if (self.width, self.height) == (self.max_width, self.max_height):
            return smallest
        return f"{smallest} to {self.max_width} × {self.max_height}"


def fourccs(node: Node) -> list[str]:
    """The camera's pixel formats by their four characters; raises OSError."""
    asked = abi.v4l2_fmtdesc(type=abi.V4L2_BUF_TYPE_VIDEO_CAPTURE)
    return [_characters(entry.pixelformat) for entry in node.entries(abi.VIDIOC_ENUM_FMT, asked)]


def sizes(node: Node, fourcc: str) -> list[Size]:
    """The sizes of frames in a format; raises OSError."""
    asked = abi.v4l2_frmsizeenum(pixel_format=abi.v4l2_fourcc(fourcc))
    return [_size(entry) for entry in node.entries(abi.VIDIOC_ENUM_FRAMESIZES, asked)]


def rates(node: Node, fourcc: str, width: int, height: int) -> list[float]:
    """The rates of such frames, frames a second, or the ends of their range; raises OSError."""
    asked = abi.v4l2_frmivalenum(pixel_format=abi.v4l2_fourcc(fourcc), width=width, height=height)
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
    """A fourcc as text; its highest bit says big-endian."""
    plain = (number & 0x7FFFFFFF).to_bytes(4, "little").decode("latin-1")
    return plain + ("-BE" if number >> 31 else "")
