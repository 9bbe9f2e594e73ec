"""Spots as a sensor with a full well of 15,000 electrons photographs them, and their centres."""

import numpy as np

from altd.records import Frame
from altd.vision.image import Centre
from support.frames import frame

SIZE = 168
FULL_WELL = 15_000.0
ELECTRONS_PER_COUNT = FULL_WELL / 255


def photographed(mean_counts: np.ndarray, read: float, rng: np.random.Generator) -> Frame:
    electrons = rng.poisson(np.maximum(mean_counts, 0) * ELECTRONS_PER_COUNT)
    return frame(electrons / ELECTRONS_PER_COUNT, rng, read)


def found(centre: Centre | None) -> Centre:
    assert centre is not None
    return centre
