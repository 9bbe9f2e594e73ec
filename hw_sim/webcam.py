"""A webcam as it is: from the light on its sensor to the grey values that a program receives."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import FloatArray, PixelArray
from hw_sim.image import Image

RED_SEEN = (1.0, 0.08, 0.02)
"""Share of red laser light, 650 nm, that the filters of the red, green and blue pixels pass."""

LUMA = (0.299, 0.587, 0.114)
"""Share of red, green and blue in the luminance (ITU-R BT.601)."""

FULL_WELL_E = 6_000.0
READ_NOISE_E = 5.0
"""Of pixels of 3 µm."""
RAW_FULL_SCALE = 1023
"""Largest value of the sensor's converter."""

HUNTING_PERIOD_S = 1.7
"""Period of an automatic gain whose control loop oscillates."""
DARK_RATIO = 2.0
"""Factor of exposure and frame period in the dark, where the exposure is automatic: 30 fps become 15."""


@dataclass(frozen=True, slots=True)
class Webcam:
    """A camera with a colour filter (RGGB), a rolling shutter and its own processing.

    ``row_time_us`` is the time from the exposure of a row to that of the next one below, 0 a global shutter.
    Without ``is_colour`` all pixels see all light. ``gamma`` is that of the 8 bits. ``jpeg_quality``: the
    frames are compressed (MJPG), and their luminance is 0 to 255; None: YUYV, 16 to 235 (BT.601).
    ``hunting`` is the amplitude by which an automatic gain swings about 1; 0: exposure and gain are fixed.
    ``late_ms`` is the mean by which a frame is stamped late, because buffers arrive in bursts.
    """

    width_px: int = 640
    height_px: int = 480
    fps: float = 30.0
    row_time_us: float = 0.0
    is_colour: bool = True
    gamma: float = 1.0
    jpeg_quality: int | None = None
    hunting: float = 0.0
    late_ms: float = 0.0

    def row_delay_s(self, rows: npt.ArrayLike) -> FloatArray:
        """Time from the exposure of the middle row to that of the rows, any shape, s."""
        return np.asarray(
            (np.asarray(rows, dtype=float) - (self.height_px - 1) / 2) * self.row_time_us * 1e-6
        )

    def gain(self, t_s: float, is_dark: bool) -> float:
        """Factor of the light at a time; an automatic exposure is longer in the dark."""
        if not self.hunting:
            return 1.0
        swing = 1.0 + self.hunting * math.sin(2.0 * math.pi * t_s / HUNTING_PERIOD_S)
        return swing * (DARK_RATIO if is_dark else 1.0)

    def period_s(self, is_dark: bool) -> float:
        """Time from a frame to the next one."""
        return (DARK_RATIO if self.hunting and is_dark else 1.0) / self.fps

    def grey(self, laser: Image, white: Image, noise: Image, gain: float = 1.0) -> PixelArray:
        """Luminance of a frame, 8 bits, (rows, columns).

        ``laser`` and ``white`` are red and white light in parts of the full scale of a pixel that sees all of
        it, ``noise`` are standard normal numbers.
        """
        light = laser * self._filter(laser.shape) + white if self.is_colour else laser + white
        electrons = np.float32(FULL_WELL_E) * light
        electrons += np.sqrt(electrons + np.float32(READ_NOISE_E**2)) * noise
        electrons *= np.float32(gain * RAW_FULL_SCALE / FULL_WELL_E)
        raw = np.clip(electrons + np.float32(0.5), 0, RAW_FULL_SCALE).astype(np.uint16)
        curve = (np.arange(RAW_FULL_SCALE + 1) / RAW_FULL_SCALE) ** (1.0 / self.gamma)
        curve = curve.astype(np.float32)
        if self.is_colour:
            colours = np.take(curve, cv2.demosaicing(raw, cv2.COLOR_BayerRGGB2RGB))
            luminance = cv2.transform(colours, np.array([LUMA]))
        else:
            luminance = np.take(curve, raw)
        if self.jpeg_quality is None:
            return np.asarray(np.rint(16.0 + 219.0 * luminance), dtype=np.uint8)
        whole = np.asarray(np.rint(255.0 * luminance), dtype=np.uint8)
        _, jpeg = cv2.imencode(".jpg", whole, (cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality))
        return np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)

    @staticmethod
    def _filter(shape: tuple[int, ...]) -> Image:
        """Share of red light that each pixel sees: rows of R, G and of G, B."""
        red, green, blue = RED_SEEN
        seen = np.full(shape, green, dtype=np.float32)
        seen[::2, ::2], seen[1::2, 1::2] = red, blue
        return seen
