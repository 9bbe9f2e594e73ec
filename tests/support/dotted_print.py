"""A print whose every dot has a place of its own: where a picture moves it is computed, not interpolated."""

from collections.abc import Callable

import numpy as np

from altd.vision.fingerprint import Fingerprint
from altd.vision.flat import Flat
from altd.vision.hot_pixels import HotPixels, places_of
from altd.vision.texture import Texture
from support.frames import HEIGHT, WIDTH

PITCH_PX = 6.0
_SIGMA_PX = 1.1
_REACH = 5
NO_HOT_PIXELS = HotPixels(places_of([]), places_of([]))

Moves = Callable[[np.ndarray], np.ndarray]
"""The present places of places (n, 2) px of the calibrated picture."""


def unmoved(places_px: np.ndarray) -> np.ndarray:
    return places_px


class DottedPrint:
    """Bright dots on a hexagonal grid, each off its place and as bright as its seed has it."""

    def __init__(self, seed: int = 1, contrast: float = 2.2) -> None:
        rng = np.random.default_rng([2, seed])
        row, column = np.mgrid[-4 : HEIGHT / (0.866 * PITCH_PX) + 4, -4 : WIDTH / PITCH_PX + 4]
        u_px, v_px = (column + 0.5 * (row % 2)) * PITCH_PX, row * 0.866 * PITCH_PX
        grid = np.column_stack([u_px.ravel(), v_px.ravel()])
        self._places_px = grid + rng.normal(0, 0.6, grid.shape)
        self._levels = contrast * rng.uniform(0.7, 1.3, len(grid))

    def response(self, moves: Moves = unmoved) -> np.ndarray:
        """The share of even light in each pixel, (rows, columns); 1 beside the dots."""
        padded = np.zeros((HEIGHT + 2 * _REACH, WIDTH + 2 * _REACH))
        places = moves(self._places_px)
        middle = np.rint(places).astype(int)
        is_seen = ((middle >= 0) & (middle < (WIDTH, HEIGHT))).all(axis=1)
        for down in range(-_REACH, _REACH + 1):
            for right in range(-_REACH, _REACH + 1):
                at = middle[is_seen] + (right, down)
                squares = np.sum((at - places[is_seen]) ** 2, axis=1)
                light = self._levels[is_seen] * np.exp(-squares / (2 * _SIGMA_PX**2))
                np.add.at(padded, (at[:, 1] + _REACH, at[:, 0] + _REACH), light)
        return 1 + padded[_REACH:-_REACH, _REACH:-_REACH]

    def flat(self) -> Flat:
        """As it was calibrated."""
        return Flat.from_response(self.response(), "print")

    def fingerprint(self, hot: HotPixels = NO_HOT_PIXELS) -> Fingerprint:
        """Of a camera that was calibrated before it."""
        return Fingerprint(hot, Texture.of_flat(self.flat()), "flat")
