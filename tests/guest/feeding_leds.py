"""Feeds pictures in which LEDs shine that hang on GPIO lines: ``feeding_leds.py FRAMES FPS DEVICE...``.

The LEDs around the front target hang on LED_A of the simulated chip ``unit``, those around the rear one on
LED_B, each lit by a high level of its pin as it is when the picture is fed. While a file CUT is there, the
cable to the LEDs is cut.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from feeding import Output, feed
from support.gpio_sim import levels_of

CHIP = "unit"
WIRED = {"front": "LED_A", "rear": "LED_B"}
CUT = Path("leds.cut")


class LedPictures:
    """The cameras' frames, from the files that ``support.fed_unit.render_with_leds`` makes."""

    def __init__(self, frames: Path) -> None:
        self.dark = np.load(frames)
        with np.load(frames.with_suffix(".npz")) as arrays:
            self._places = [arrays[f"{camera}_places"] for camera in WIRED]
            self._lit = [arrays[f"{camera}_lit"] for camera in WIRED]

    def take(self, number: int) -> Iterator[np.ndarray]:
        """The pictures of an exposure, as the pins are now."""
        number %= len(self.dark)
        for index, shines in enumerate(_levels()):
            picture = self.dark[number, index]
            if shines:
                picture = picture.copy()
                picture.flat[self._places[index]] = self._lit[index][number]
            yield picture


def _levels() -> list[int]:
    """Of the LEDs' pins; a chip that is not plugged in drives none."""
    try:
        return [0, 0] if CUT.exists() else levels_of(CHIP, WIRED.values())
    except OSError:
        return [0, 0]


if __name__ == "__main__":
    pictures = LedPictures(Path(sys.argv[1]))
    outputs = [Output(Path(device), *pictures.dark.shape[2:]) for device in sys.argv[3:]]
    feed(pictures.take, float(sys.argv[2]), outputs)
