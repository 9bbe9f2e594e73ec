"""The fitted profile against the Cramér-Rao bound; frames and bound come from formulas, not from the fit."""

from __future__ import annotations

import numpy as np
import pytest
from support.cramer_rao import cramer_rao
from support.frames import Blob, frame, light

from altd.reasons import Reason
from altd.records import Frame, Spot
from altd.vision.flat import Flat
from altd.vision.localise import locate
from altd.vision.settings import SpotSettings

SIZE = 168
READ_COUNTS, ELECTRONS_PER_COUNT = 0.7, 15_000 / 255


def dots(pitch_px: float = 4.3, radius_px: float = 1.1, turn_rad: float = 0.03) -> np.ndarray:
    """A hexagonal print on dark glass, mean 1, each pixel the mean over 5 × 5 points."""
    sub = (np.arange(5 * SIZE) - 2) / 5
    x, y = np.meshgrid(sub, sub)
    across, up = (
        x * np.cos(turn_rad) + y * np.sin(turn_rad),
        y * np.cos(turn_rad) - x * np.sin(turn_rad),
    )
    row = pitch_px * np.sqrt(3)
    inside = np.zeros(x.shape, bool)
    for shift in (0.0, 0.5):
        from_x = across / pitch_px - shift
        from_y = up / row - shift
        inside |= (
            np.hypot((from_x - np.rint(from_x)) * pitch_px, (from_y - np.rint(from_y)) * row) < radius_px
        )
    response = 0.1 + inside.reshape(SIZE, 5, SIZE, 5).mean(axis=(1, 3))
    return response / response.mean()


def photographed(mean_counts: np.ndarray, rng: np.random.Generator) -> Frame:
    electrons = rng.poisson(np.maximum(mean_counts, 0) * ELECTRONS_PER_COUNT)
    return frame(electrons / ELECTRONS_PER_COUNT, rng, READ_COUNTS)


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
    assert rms_px >= 0.9 * bound_px  # nobody beats the bound: else frames or bound are wrong


def test_on_print_with_a_flat_the_error_is_near_the_bound() -> None:
    response = dots()
    rms_px, bound_px, failures = rms_and_bound_px(300, response, Flat.of(response, "recording"), 45.0, 2)
    assert failures == 0
    assert 0.9 * bound_px <= rms_px <= 1.5 * bound_px


def test_without_a_flat_print_moves_the_spot_far_more() -> None:
    response = dots()
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(40):
        u, v = rng.uniform(78, 90, 2)
        spot = locate(photographed(response * light(Blob(u, v), width=SIZE, height=SIZE) * 0.3, rng))
        assert isinstance(spot, Spot)
        errors.append((spot.u_px - u, spot.v_px - v))
    assert 0.01 < np.sqrt(np.mean(np.square(errors))) < 0.06


def test_the_bound_of_a_mean_is_the_textbook_one() -> None:
    covariance = cramer_rao(lambda p: np.full(50, p[0]), [3.0], np.full(50, 4.0))
    assert covariance[0, 0] == pytest.approx(4.0 / 50)


def test_a_clipped_spot_is_still_found_where_it_is() -> None:
    response = np.ones((SIZE, SIZE))
    rng = np.random.default_rng(4)
    spot = locate(photographed(response * light(Blob(84.3, 80.7, peak=262), width=SIZE, height=SIZE), rng))
    assert isinstance(spot, Spot)
    assert (spot.u_px, spot.v_px) == pytest.approx((84.3, 80.7), abs=0.03)


@pytest.mark.parametrize("radius_px", [8.0, 25.0, 200.0])
def test_a_flat_that_is_black_where_the_spot_lies_gives_a_reason_or_the_spot(radius_px: float) -> None:
    v, u = np.mgrid[:SIZE, :SIZE]
    response = np.where(np.hypot(u - 84, v - 80) < radius_px, 0.0, 1.0)
    shot = photographed(light(Blob(84.3, 80.7), width=SIZE, height=SIZE), np.random.default_rng(5))
    spot = locate(shot, flat=Flat.of(response, "recording"))
    if isinstance(spot, Spot):
        assert radius_px < 10  # the rim tells enough
        assert (spot.u_px, spot.v_px) == pytest.approx((84.3, 80.7), abs=0.15)
    else:
        assert spot.reason is Reason.WRONG_SHAPE


@pytest.mark.parametrize(("width", "height", "bits"), [(166, 165, 10), (163, 167, 12), (165, 166, 16)])
def test_deep_pictures_of_any_size_are_fitted_through_their_flat(width: int, height: int, bits: int) -> None:
    response = dots()[:height, :width]
    scale = (1 << bits) / 256
    rng = np.random.default_rng(bits)
    for u, v in ((84.0, 80.0), (width - 36.0, height - 36.0), (37.5, 35.5)):
        counts = response * light(Blob(u, v, peak=45.0), width=width, height=height) * scale
        shot = frame(counts, rng, READ_COUNTS * scale, background=8 * scale, bits=bits)
        spot = locate(shot, flat=Flat.of(response, "recording"))
        assert isinstance(spot, Spot)
        assert (spot.u_px, spot.v_px) == pytest.approx((u, v), abs=0.06)


@pytest.mark.parametrize("order", [0.7, 1.5, 3.0, 10.0])
@pytest.mark.parametrize("diameter_px", [16.0, 30.0, 44.0])
def test_spots_from_peaked_to_flat_topped_are_fitted(order: float, diameter_px: float) -> None:
    rng = np.random.default_rng(5)
    v, u = np.mgrid[:SIZE, :SIZE].astype(float)
    for ratio in (0.45, 1.0):
        u_px, v_px, angle = *rng.uniform(80, 88, 2), rng.uniform(0, np.pi)
        along = (u - u_px) * np.cos(angle) + (v - v_px) * np.sin(angle)
        across = (v - v_px) * np.cos(angle) - (u - u_px) * np.sin(angle)
        rho2 = (2 * along / diameter_px) ** 2 + (2 * across / (ratio * diameter_px)) ** 2
        spot = locate(photographed(180 * np.exp(-2 * rho2**order), rng), SpotSettings(max_diameter_px=120.0))
        assert isinstance(spot, Spot), spot
        assert (spot.u_px, spot.v_px) == pytest.approx((u_px, v_px), abs=0.1)
