"""The frame LEDs one by one, and lights that are not frame LEDs."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from hw_sim.image import Image
from hw_sim.targets import LED_DIAMETER_MM, LED_POSITIONS_MM, soft_disc

ALL_LIT = (1.0,) * len(LED_POSITIONS_MM)
"""Usual brightness of each LED, in the order of LED_POSITIONS_MM."""


class Shines(StrEnum):
    """Times at which a light that is not a frame LED is lit."""

    WITH_LEDS = "with_leds"
    """Together with the LEDs, as their reflection."""
    BY_ITSELF = "by_itself"
    """In every second exposure on average, independently of the LEDs."""
    ALWAYS = "always"


@dataclass(frozen=True, slots=True)
class Stray:
    """A round light on a target that is not a frame LED; ``level`` 1 is the brightness of a frame LED."""

    x_mm: float
    y_mm: float
    diameter_mm: float = LED_DIAMETER_MM
    level: float = 1.0
    shines: Shines = Shines.WITH_LEDS


def led_coverage(x_mm: Image, y_mm: Image, softness_mm: float, levels: tuple[float, ...] = ALL_LIT) -> Image:
    """Light of the frame LEDs in a small cell at points of the frame; 1 within an LED of usual brightness.

    ``levels`` is the brightness of each LED; 0 is dark.
    """
    cover = np.zeros_like(x_mm)
    for (led_x, led_y), level in zip(LED_POSITIONS_MM, levels, strict=True):
        if level:
            reach_mm = np.float32(LED_DIAMETER_MM / 2.0 + softness_mm)
            near = np.abs(x_mm - np.float32(led_x)) < reach_mm
            near &= np.abs(y_mm - np.float32(led_y)) < reach_mm
            distance = np.hypot(x_mm[near] - np.float32(led_x), y_mm[near] - np.float32(led_y))
            cover[near] += np.float32(level) * soft_disc(distance, LED_DIAMETER_MM / 2.0, softness_mm)
    return cover


def stray_coverage(x_mm: Image, y_mm: Image, softness_mm: float, strays: tuple[Stray, ...]) -> Image:
    """Light of the strays in the unit of ``led_coverage``."""
    cover = np.zeros_like(x_mm)
    for stray in strays:
        distance = np.hypot(x_mm - np.float32(stray.x_mm), y_mm - np.float32(stray.y_mm))
        cover += np.float32(stray.level) * soft_disc(distance, stray.diameter_mm / 2.0, softness_mm)
    return cover
