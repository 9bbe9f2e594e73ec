"""The background against a fall-off by formula."""

from __future__ import annotations

import numpy as np
from support.frames import HEIGHT, WIDTH, frame, light

from altd.vision.search import coarse_image, fit_background


def test_sloping_light_behind_the_fall_off_of_a_lens_is_followed() -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    from_axis = np.hypot(u - WIDTH / 2 + 4, v - HEIGHT / 2 - 3) / 900.0  # in focal lengths
    falling = 60 / (1 + from_axis**2) ** 2 * (1 + 0.3 * u / WIDTH - 0.2 * v / HEIGHT)
    seen = frame(light() + falling, np.random.default_rng(1), noise=1.0, background=4.0)
    background = fit_background(coarse_image(seen.pixels)).at((0.0, 0.0), (HEIGHT, WIDTH))
    off = background - falling - 4.0
    assert np.sqrt(np.mean(np.square(off))) < 0.15
    assert np.abs(off).max() < 0.8  # in a corner
    assert background[HEIGHT // 2, WIDTH // 2] - background[0, 0] > 10
