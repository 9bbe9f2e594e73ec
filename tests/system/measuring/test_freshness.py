"""A camera whose dark is cut off at black: thousands of its pixels are equal from frame to frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH, Blob, frame, light

from altd.measuring.freshness import FreshnessCheck

SPOT = light(Blob(300.0, 200.0))
PERIOD_NS = 50_000_000


@pytest.mark.parametrize("background", [-5.0, -1.0, 0.0, 0.4, 4.0])
def test_a_camera_that_cuts_its_dark_off_at_black_is_no_repeat(background: float) -> None:
    """The noise of the dark is hidden there, and hot pixels stand at full scale."""
    rng = np.random.default_rng(5)
    hot = rng.random((HEIGHT, WIDTH)) < 1e-3
    shot_noise = 0.1 * np.sqrt(SPOT)
    frames = []
    for n in range(150):
        image = SPOT + shot_noise * rng.standard_normal(SPOT.shape)
        taken = frame(image, rng, 0.2, background, sequence=n, t_ns=n * PERIOD_NS)
        frames.append(replace(taken, pixels=np.where(hot, 255, taken.pixels).astype(np.uint8)))
    check = FreshnessCheck()
    assert not any(check.repeated(frame) for frame in frames)
