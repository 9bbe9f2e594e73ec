"""The fitted profile on clean and printed targets; frames and bound come from formulas, not from the fit."""

import numpy as np
import pytest
from support.cramer_rao import cramer_rao
from support.frames import Blob, frame, light
from support.printed_glass import READ_COUNTS, SIZE, dots, photographed

from altd.reasons import Reason
from altd.records import Spot
from altd.vision.flat import Flat
from altd.vision.localise import locate
from altd.vision.settings import SpotSettings


def test_without_a_flat_print_moves_the_spot_far_more() -> None:
    response = dots()
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(40):
        u, v = rng.uniform(78, 90, 2)
        spot = locate(photographed(response * light(Blob(u, v), width=SIZE, height=SIZE) * 0.3, rng))
        errors.append((spot.u_px - u, spot.v_px - v))
    assert 0.01 < np.sqrt(np.mean(np.square(errors))) < 0.06


def test_the_bound_of_a_mean_is_the_textbook_one() -> None:
    covariance = cramer_rao(lambda p: np.full(50, p[0]), [3.0], np.full(50, 4.0))
    assert covariance[0, 0] == pytest.approx(4.0 / 50)


def test_a_clipped_spot_is_still_found_where_it_is() -> None:
    response = np.ones((SIZE, SIZE))
    rng = np.random.default_rng(4)
    spot = locate(photographed(response * light(Blob(84.3, 80.7, peak=262), width=SIZE, height=SIZE), rng))
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
