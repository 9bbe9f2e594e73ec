"""The error of the fitted profile over many frames against the Cramér-Rao bound."""

import numpy as np
from support.cramer_rao import cramer_rao
from support.frames import Blob, light
from support.printed_glass import ELECTRONS_PER_COUNT, READ_COUNTS, SIZE, dots, photographed

from altd.records import Spot
from altd.vision.flat import Flat
from altd.vision.localise import locate


def rms_and_bound_px(
    frames: int, response: np.ndarray, flat: Flat | None, peak: float, seed: int
) -> tuple[float, float, int]:
    """Rms error per axis, the bound's, and how many frames gave no spot."""
    rng = np.random.default_rng(seed)
    errors, bounds, failures = [], [], 0
    for index in range(frames):
        u, v = rng.uniform(78, 90, 2)
        diameters = rng.uniform(38, 48, 2)
        angle = rng.uniform(0, np.pi)

        def mean(p: np.ndarray, angle: float = angle) -> np.ndarray:
            return response * light(Blob(p[1], p[2], p[3], p[4], angle, p[0]), width=SIZE, height=SIZE)

        truth = np.array([peak, u, v, *diameters])
        expected = mean(truth)
        spot = locate(photographed(expected, rng), flat=flat)
        if not isinstance(spot, Spot):
            failures += 1
            continue
        errors.append((spot.u_px - u, spot.v_px - v))
        if index % 10 == 0:
            variance = READ_COUNTS**2 + 1 / 12 + expected / ELECTRONS_PER_COUNT
            bounds.append(np.diag(cramer_rao(mean, truth, variance))[1:3])
    return float(np.sqrt(np.mean(np.square(errors)))), float(np.sqrt(np.mean(bounds))), failures


def test_on_a_clean_target_the_error_is_the_bound() -> None:
    rms_px, bound_px, failures = rms_and_bound_px(700, np.ones((SIZE, SIZE)), None, 150.0, seed=1)
    assert failures == 0
    assert rms_px <= 1.15 * bound_px
    assert rms_px >= 0.9 * bound_px  # nothing beats the bound: else frames or bound are wrong


def test_on_print_with_a_flat_the_error_is_near_the_bound() -> None:
    response = dots()
    rms_px, bound_px, failures = rms_and_bound_px(300, response, Flat.of(response, "recording"), 45.0, 2)
    assert failures == 0
    assert 0.9 * bound_px <= rms_px <= 1.5 * bound_px
