"""What a Video4Linux buffer holds, without input or output: grey values, an instant."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from mmap import mmap
from typing import Literal

import numpy as np
import numpy.typing as npt

from altd.records import PixelArray

_MAX_CLOCK_DIFFERENCE_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """A grey format: its four characters, the significant bits, and the numbers in the buffer."""

    name: str
    fourcc: str
    bits: int
    dtype: npt.DTypeLike

    @property
    def bytes_per_pixel(self) -> int:
        """One, or two with the significant bits at the low end."""
        return np.dtype(self.dtype).itemsize


PIXEL_FORMATS = {
    entry.name: entry
    for entry in (
        PixelFormat("GREY", "GREY", 8, np.uint8),
        PixelFormat("Y10", "Y10 ", 10, "<u2"),
        PixelFormat("Y12", "Y12 ", 12, "<u2"),
        PixelFormat("Y16", "Y16 ", 16, "<u2"),
    )
}
"""By the names in ``altd.toml``."""


@dataclass(frozen=True, slots=True)
class Layout:
    """How a frame lies in a buffer; a line may be followed by padding."""

    width: int
    height: int
    bytes_per_line: int
    pixel_format: PixelFormat

    @property
    def frame_bytes(self) -> int:
        """What a whole frame takes; the last line may come without its padding."""
        return self.bytes_per_line * (self.height - 1) + self.width * self.pixel_format.bytes_per_pixel

    def pixels(self, buffer: bytes | memoryview | mmap) -> PixelArray:
        """The frame's grey values, (rows, columns), read-only.

        Copied, once: the driver gets the buffer back at once and fills it again, while a frame lives as long
        as anybody looks at it.
        """
        lines: npt.NDArray[np.uint8] = np.ndarray(
            (self.height, self.width),
            self.pixel_format.dtype,
            buffer,
            strides=(self.bytes_per_line, self.pixel_format.bytes_per_pixel),
        )
        pixels = lines.copy()
        pixels.flags.writeable = False
        return pixels


class Stamp(Enum):
    """What a driver stamps: the beginning of the exposure, or when the last pixel was there."""

    START_OF_EXPOSURE = auto()
    END_OF_FRAME = auto()


def middle_of_exposure_ns(
    stamp_ns: int,
    clock: Literal["monotonic", "unknown"],
    source: Stamp,
    exposure_ms: float | None,
    now_ns: int,
) -> int:
    """The middle of an exposure on the monotonic clock, as well as the driver lets it be known.

    A stamp of an unknown clock is taken for the monotonic one when it is less than a second from
    ``now_ns``; otherwise ``now_ns``, when the frame was taken from the driver, stands for it. Half of the
    exposure is added to its beginning or taken off its end; an unknown one counts as zero. The time that
    the sensor takes to be read is in a stamp of the second kind, and stays: no driver tells it.
    """
    if clock == "unknown" and abs(stamp_ns - now_ns) > _MAX_CLOCK_DIFFERENCE_NS:
        stamp_ns = now_ns
    half_ns = round((exposure_ms or 0.0) * 0.5e6)
    return stamp_ns + half_ns if source is Stamp.START_OF_EXPOSURE else stamp_ns - half_ns
