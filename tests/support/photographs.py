"""Spots on clean and printed glass, photographed by a full well of 15,000 electrons, and their centres."""

import numpy as np

from altd.records import Frame
from altd.vision.image import Centre
from support.frames import frame

SIZE = 168
FULL_WELL = 15_000.0
READ_COUNTS, ELECTRONS_PER_COUNT = 0.7, FULL_WELL / 255


def dots(pitch_px: float = 4.3, radius_px: float = 1.1, turn_rad: float = 0.03) -> np.ndarray:
    """A hexagonal print on dark glass, mean 1, each pixel the mean over 5 × 5 points."""
    sub = (np.arange(5 * SIZE) - 2) / 5
    x, y = np.meshgrid(sub, sub)
    across, up = (x * np.cos(turn_rad) + y * np.sin(turn_rad), y * np.cos(turn_rad) - x * np.sin(turn_rad))
    row = pitch_px * np.sqrt(3)
    inside = np.zeros(x.shape, bool)
    for shift in (0.0, 0.5):
        from_x = across / pitch_px - shift
        from_y = up / row - shift
        off_u, off_v = (from_x - np.rint(from_x)) * pitch_px, (from_y - np.rint(from_y)) * row
        inside |= np.hypot(off_u, off_v) < radius_px
    response = 0.1 + inside.reshape(SIZE, 5, SIZE, 5).mean(axis=(1, 3))
    return response / response.mean()


def photographed(mean_counts: np.ndarray, rng: np.random.Generator, read: float = READ_COUNTS) -> Frame:
    electrons = rng.poisson(np.maximum(mean_counts, 0) * ELECTRONS_PER_COUNT)
    return frame(electrons / ELECTRONS_PER_COUNT, rng, read)


def found(centre: Centre | None) -> Centre:
    assert centre is not None
    return centre
