"""Sigma of a located spot against the scatter of many frames."""

import numpy as np
import pytest
from support.frames import Blob, frame, light

from altd.records import Spot
from altd.vision.localise import locate


def test_sigma_is_the_scatter_that_read_and_shot_noise_make() -> None:
    rng = np.random.default_rng(1)
    full_well, full_scale, read = 15_000.0, 255.0, 2.0
    image = light(Blob(380.4, 240.2))
    positions, sigmas = [], []
    for _ in range(120):
        electrons = rng.poisson((image + 8) * full_well / full_scale)
        noisy = electrons * full_scale / full_well - 8
        spot = locate(frame(noisy, rng, noise=read))
        assert isinstance(spot, Spot), spot
        positions.append((spot.u_px, spot.v_px))
        sigmas.append(spot.sigma_px)
    scatter = np.sqrt(np.var(positions, axis=0, ddof=1).mean())
    assert np.mean(sigmas) / scatter == pytest.approx(1.0, abs=0.15)
