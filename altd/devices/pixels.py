"""Grey values from the bytes of a camera's frame.

Sources: "Image Formats" of the Linux Media Infrastructure userspace API (GREY … MJPG); GenICam Pixel Format
Naming Convention 2.4, and the GigE Vision standard for its own packed formats (Mono8 … Mono12Packed).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from mmap import mmap

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import PixelArray

Bytes = bytes | memoryview | mmap
_Groups = npt.NDArray[np.uint8]
"""Bytes (rows, groups, bytes of a group) of the smallest groups of pixels that begin at a byte."""
_JPEG_BYTES_PER_PIXEL = 0.3
_WHITE = 235
"""White of a luminance of limited range (ITU-R BT.601); sensors clip at it or above."""


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """A format by its name in ``altd.toml``: its significant bits, and its groups of pixels in a line.

    ``unpack`` returns the grey values (rows, groups · ``group_pixels``) of groups; None: a frame is a JPEG.
    """

    name: str
    bits: int
    group_pixels: int
    group_bytes: int
    unpack: Callable[[_Groups], PixelArray] | None

    @property
    def bytes_per_pixel(self) -> float:
        """Bytes per pixel, without colour behind the picture; of a JPEG, which vary, a large one."""
        return _JPEG_BYTES_PER_PIXEL if self.unpack is None else self.group_bytes / self.group_pixels

    def line_bytes(self, width: int) -> int:
        """Bytes of a line without padding; raises ValueError where it does not end with a byte."""
        if width % self.group_pixels:
            raise ValueError(f"the width of {self.name} is a multiple of {self.group_pixels}, not {width}")
        return width // self.group_pixels * self.group_bytes

    def frame_bytes(self, width: int, height: int, bytes_per_line: int) -> int:
        """Least bytes of a frame; the last line may lack its padding. A JPEG has at least its markers."""
        if self.unpack is None:
            return len(_JPEG_BEGIN + _JPEG_END)
        return bytes_per_line * (height - 1) + self.line_bytes(width)

    def pixels(
        self, data: Bytes, width: int, height: int, bytes_per_line: int, *, is_lent: bool = False
    ) -> PixelArray:
        """Grey values (rows, columns) of a frame, read-only; raises ValueError for a damaged JPEG.

        ``data`` has ``frame_bytes`` or more. Values of data that are lent are copied: a driver gets its
        buffer back at once and fills it again, while a frame lives as long as it is in use.
        """
        if self.unpack is None:
            pixels = _decoded(data, width, height)
        else:
            shape = height, width // self.group_pixels, self.group_bytes
            strides = bytes_per_line, self.group_bytes, 1
            pixels = self.unpack(np.ndarray(shape, np.uint8, data, strides=strides))
        if is_lent and not pixels.flags.owndata:
            pixels = pixels.copy()
        pixels.flags.writeable = False
        return pixels


def _byte(groups: _Groups) -> PixelArray:
    return groups[..., 0]


def _word(groups: _Groups) -> PixelArray:
    words: PixelArray = groups.view("<u2")[..., 0]
    return words


def _luminance(at: int) -> Callable[[_Groups], PixelArray]:
    """Return the unpacking of a luminance beside its colour.

    White and above it becomes 255: a spot that a sensor clips at 235 must not seem to have a flat top.
    """

    def unpack(groups: _Groups) -> PixelArray:
        grey = groups[..., at].copy()
        grey[grey >= _WHITE] = 255
        return grey

    return unpack


def _packed(
    bits: int, high: slice, high_shift: tuple[int, ...], low: slice, low_shift: tuple[int, ...]
) -> Callable[[_Groups], PixelArray]:
    """Return the unpacking of pixels whose bits lie in two bytes.

    Byte ``high`` of each pixel is shifted left, byte ``low`` right, both by ``…_shift`` bits. Of the shifted
    bytes, all bits of one and the rest of the other belong to the pixel.
    """
    left = np.array(high_shift, dtype=np.uint16)
    right = np.array(low_shift, dtype=np.uint16)
    lowest = high_shift[0] == bits - 8
    mask = np.uint16((1 << bits - 8) - 1 if lowest else (1 << bits) - 1)

    def unpack(groups: _Groups) -> PixelArray:
        above = groups[..., high].astype(np.uint16) << left
        below = groups[..., low].astype(np.uint16) >> right
        grey = above | (below & mask) if lowest else (above | below) & mask
        pixels: PixelArray = grey.reshape(len(groups), -1)
        return pixels

    return unpack


_JPEG_BEGIN, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
_JPEG_SIZES = b"\xc0", b"\xc1"
"""Markers of frames with their size: baseline and extended (ITU-T T.81, table B.1); none is progressive."""
_JPEG_GOES_ON = bytes(8)


def _decoded(data: Bytes, width: int, height: int) -> PixelArray:
    """Luminance of a JPEG of this size; raises ValueError for anything else, also for one that lacks bytes.

    The size is read first: a decoder allocates what a picture claims. At the end marker it fills what is
    missing with grey. Without that marker it fails: there are only the few bytes that it reads ahead.
    A picture is as the sensor has it, whatever orientation it claims.
    """
    content = bytes(data).rstrip(b"\0")
    if not content.startswith(_JPEG_BEGIN):
        raise ValueError("is no whole JPEG")
    at = len(_JPEG_BEGIN)
    while content[at : at + 1] == b"\xff" and content[at + 1 : at + 2] not in _JPEG_SIZES:
        at += 2 + int.from_bytes(content[at + 2 : at + 4], "big")
    size = content[at + 5 : at + 9]
    if size != height.to_bytes(2, "big") + width.to_bytes(2, "big"):
        raise ValueError("is a JPEG of another size or kind")
    end = content.find(_JPEG_END, at)
    if end < 0 or end + len(_JPEG_END) < len(content):
        raise ValueError("is no whole JPEG")
    endless = np.frombuffer(content[:end] + _JPEG_GOES_ON, np.uint8)
    decoded = cv2.imdecode(endless, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if decoded is None:
        raise ValueError("is no JPEG that can be decoded")
    return decoded.astype(np.uint8, copy=False)


_FORMATS = (
    PixelFormat("GREY", 8, 1, 1, _byte),
    PixelFormat("Y10", 10, 1, 2, _word),
    PixelFormat("Y12", 12, 1, 2, _word),
    PixelFormat("Y16", 16, 1, 2, _word),
    PixelFormat("Y10P", 10, 4, 5, _packed(10, slice(0, 4), (2,) * 4, slice(4, 5), (0, 2, 4, 6))),
    PixelFormat("Y12P", 12, 2, 3, _packed(12, slice(0, 2), (4,) * 2, slice(2, 3), (0, 4))),
    PixelFormat("NV12", 8, 1, 1, _luminance(0)),
    PixelFormat("YUYV", 8, 1, 2, _luminance(0)),
    PixelFormat("UYVY", 8, 1, 2, _luminance(1)),
    PixelFormat("MJPG", 8, 1, 1, None),
    PixelFormat("Mono8", 8, 1, 1, _byte),
    PixelFormat("Mono10", 10, 1, 2, _word),
    PixelFormat("Mono12", 12, 1, 2, _word),
    PixelFormat("Mono16", 16, 1, 2, _word),
    PixelFormat("Mono10p", 10, 4, 5, _packed(10, slice(1, 5), (8, 6, 4, 2), slice(0, 4), (0, 2, 4, 6))),
    PixelFormat("Mono12p", 12, 2, 3, _packed(12, slice(1, 3), (8, 4), slice(0, 2), (0, 4))),
    PixelFormat("Mono10Packed", 10, 2, 3, _packed(10, slice(0, 3, 2), (2, 2), slice(1, 2), (0, 4))),
    PixelFormat("Mono12Packed", 12, 2, 3, _packed(12, slice(0, 3, 2), (4, 4), slice(1, 2), (0, 4))),
)
PIXEL_FORMATS = {entry.name: entry for entry in _FORMATS}
"""Pixel formats by their names in ``altd.toml``: those of Video4Linux, and of GigE and USB3 Vision."""
