"""Frames, their origin, and the arrays of numbers in them and in the measuring chain."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
"""Vectors, matrices and covariances of the measuring chain."""

ComplexArray = npt.NDArray[np.complex128]
"""Waves and their amplitudes."""

PixelArray = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
"""A frame's grey values, (rows, columns)."""

MAX_ROW_TIME_US = 1000.0
"""Largest delay of a row of a rolling shutter; common are 10 to 70 µs."""


class Origin(StrEnum):
    """Origin of frames: exposed by a camera, or computed by a simulator.

    Recordings and calibrations store it, and everything derived from simulated frames is marked.
    """

    CAMERA = "camera"
    SIMULATED = "simulated"


@dataclass(frozen=True, slots=True)
class CameraIdentity:
    """Identity of a camera as its driver reports it; None: not known."""

    serial: str | None = None
    model: str | None = None
    driver: str | None = None

    def difference_from(self, expected: CameraIdentity) -> str:
        """Return the difference between this camera and the expected one, in words; empty if none.

        Values that one of the two lacks are not compared, and nothing is if the drivers differ, because
        another driver names cameras differently.
        """
        if None not in (self.driver, expected.driver) and self.driver != expected.driver:
            return ""
        for what in ("serial", "model"):
            is_, should_be = getattr(self, what), getattr(expected, what)
            if None not in (is_, should_be) and is_ != should_be:
                return f"its {what} is {is_!r}, expected {should_be!r}"
        return ""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One exposure of one camera.

    ``pixels`` is read-only, (rows, columns), uint8 or uint16 with ``bits`` significant bits; ``t_ns`` is the
    middle of the exposure on the monotonic clock, of the middle row if a rolling shutter exposes each row
    ``row_time_us`` after the one above; ``sequence`` counts the camera's exposures, including lost ones.
    ``exposure_ms`` and ``gain_db`` are reported by the camera, else its settings, else None.
    ``changing``: exposure or gain was being set; the value of this frame is unknown. ``playthrough`` counts
    how often a recording was played before: its pictures are repeated intentionally. ``opaque`` names the
    target that was switched to show the spot; empty: none.
    """

    camera: str
    sequence: int
    t_ns: int
    pixels: PixelArray
    bits: int = 8
    leds_on: bool = False
    exposure_ms: float | None = None
    gain_db: float | None = None
    changing: bool = False
    playthrough: int = 0
    opaque: str = ""
    row_time_us: float = 0.0

    def row_delay_ns(self, row: float) -> int:
        """Return the time from the exposure of the middle row to that of another one, ns."""
        return round((row - (len(self.pixels) - 1) / 2) * self.row_time_us * 1e3)

    @property
    def per_ms(self) -> float | None:
        """Factor from counts to those for 1 ms and 0 dB of gain; None if the exposure is not known.

        A gain of g dB multiplies counts by 10^(g/20). A camera without a gain of its own has 0 dB.
        """
        if not self.exposure_ms:
            return None
        return 1 / (self.exposure_ms * 10 ** ((self.gain_db or 0.0) / 20))

    @property
    def full_scale(self) -> int:
        """Largest grey value of a pixel."""
        return (1 << self.bits) - 1
