"""Series of new frames in which nothing comes again, also where the dark is cut off at black."""

from dataclasses import replace

import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH, Blob, frame, light

from altd.measuring.freshness import FreshnessCheck

SPOT = light(Blob(300.0, 200.0))
PERIOD_NS = 50_000_000


@pytest.mark.parametrize("background", [-5.0, -1.0, 0.0, 0.4, 4.0])
def test_a_camera_that_cuts_its_dark_off_at_black_is_no_repeat(background: float) -> None:
    """The noise of the dark is hidden there, and hot pixels are at full scale."""
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


@pytest.mark.parametrize("bits", [8, 10, 16])
@pytest.mark.parametrize("noise", [0.3, 2.0])
def test_what_was_exposed_is_new(bits: int, noise: float) -> None:
    rng = np.random.default_rng(0)
    image, check = SPOT * (1 << bits) / 256, FreshnessCheck()
    for n in range(150):
        assert not check.repeated(frame(image, rng, noise, 8.0, bits, sequence=n, t_ns=n * PERIOD_NS))
