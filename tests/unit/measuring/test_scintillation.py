"""Windows of exposures with unexplained light: at random, steady, slow, and on one target alone."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from altd.measuring.scintillation import averaged_residuals
from altd.reasons import Reason
from altd.records import Fault, FrameSet, NoSpot, Spot
from altd.records.spots import Unexplained

N, PATTERNS, USUAL, BIAS_PX = 20, 27, 36.0, 0.03
REFUSED = (Fault(Reason.DISTORTED, "front"),)
Scores = Callable[[np.random.Generator], np.ndarray]


def at_random(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(0, 5, (N, PATTERNS))


def steady(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(0, 4, PATTERNS) + rng.normal(0, 1, (N, PATTERNS))


def slow(rng: np.random.Generator) -> np.ndarray:
    """A drop that runs through the spot."""
    first, last = rng.normal(0, 6, (2, PATTERNS))
    turns = np.linspace(0, 2 * np.pi, N)[:, None]
    return np.cos(turns) * first + np.sin(turns) * last


def on_and_off(rng: np.random.Generator) -> np.ndarray:
    """A reflection of a lamp that flickers."""
    return rng.normal(0, 5, PATTERNS) * (rng.random((N, 1)) < 0.6) + rng.normal(0, 1, (N, PATTERNS))


def seen(scores: np.ndarray) -> Spot | NoSpot:
    """A spot with these scores, which is distorted from a chi-square of 300 on."""
    unexplained = Unexplained(np.stack([scores, scores]), USUAL, BIAS_PX)
    spot = Spot(300, 200, 0.02, 42, 150)
    if scores @ scores > USUAL:
        spot = replace(spot, excess_px=unexplained.displacement_px, unexplained=unexplained)
    return NoSpot(Reason.DISTORTED, spot=spot) if scores @ scores > 300 else spot


def window(front: Scores, rear: Scores) -> list[FrameSet]:
    rng = np.random.default_rng(3)
    each = zip(front(rng), rear(rng), strict=True)
    return [
        FrameSet(number, number * 50_000_000, {"front": seen(one), "rear": seen(other)})
        for number, (one, other) in enumerate(each)
    ]


def test_light_that_differs_at_random_is_averaged() -> None:
    frame_sets = averaged_residuals(window(at_random, at_random), REFUSED)
    assert frame_sets is not None
    for spots in (frame_set.spots for frame_set in frame_sets):
        for spot in spots.values():
            assert isinstance(spot, Spot)
            assert spot.excess_px < 0.1


@pytest.mark.parametrize("other", [steady, slow, on_and_off])
def test_light_that_does_not_differ_at_random_is_not_averaged(other: Scores) -> None:
    assert averaged_residuals(window(other, other), REFUSED) is None
    assert averaged_residuals(window(at_random, other), REFUSED) is None
    assert averaged_residuals(window(other, at_random), REFUSED) is None


def test_what_the_exposures_have_in_common_stays_in_sigma() -> None:
    def both(rng: np.random.Generator) -> np.ndarray:
        return at_random(rng) + 1.7

    frame_sets = averaged_residuals(window(both, at_random), REFUSED)
    assert frame_sets is not None
    spot = frame_sets[0].spots["front"]
    assert isinstance(spot, Spot)
    assert spot.excess_px == pytest.approx(BIAS_PX * np.sqrt(1.7**2 * PATTERNS - USUAL), rel=0.35)


def test_few_exposures_and_good_ones_are_left_alone() -> None:
    assert averaged_residuals(window(at_random, at_random)[:9], REFUSED) is None
    assert averaged_residuals(window(at_random, at_random), (Fault(Reason.SPOT_MISSING, "front"),)) is None
