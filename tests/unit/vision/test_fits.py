"""Fits of a spot, against formulas, OpenCV and a bound: the ellipse, and the profile on clean and print."""

from dataclasses import astuple

import cv2
import numpy as np
import pytest
from support.cramer_rao import cramer_rao
from support.frames import HEIGHT, WIDTH, Blob, frame, light
from support.photographs import FULL_WELL, READ_COUNTS, SIZE, dots, found, photographed

from altd.reasons import Reason
from altd.records import Frame, Spot
from altd.vision.ellipse import fit_conic
from altd.vision.flat import Flat
from altd.vision.localise import fitted_profile, locate, locate_ellipse
from altd.vision.settings import SpotSettings


def super_gaussian(
    u_px: float, v_px: float, diameters_px: tuple[float, float], angle_rad: float, order: float, bits: int
) -> np.ndarray:
    """A spot of exp(−2 ρ^(2·order)), ρ = 1 on the 1/e² ellipse, counts: 60 % of full scale above 3 %."""
    v, u = np.mgrid[:320, :400].astype(float)
    along = (u - u_px) * np.cos(angle_rad) + (v - v_px) * np.sin(angle_rad)
    across = (v - v_px) * np.cos(angle_rad) - (u - u_px) * np.sin(angle_rad)
    rho2 = (2 * along / diameters_px[0]) ** 2 + (2 * across / diameters_px[1]) ** 2
    return ((1 << bits) - 1) * (0.03 + 0.6 * np.exp(-2 * rho2**order))


def exposed(mean: np.ndarray, bits: int, rng: np.random.Generator) -> Frame:
    """Shot noise of a full well at full scale, and read noise of 40 electrons."""
    per_count = FULL_WELL / ((1 << bits) - 1)
    counts = (rng.poisson(mean * per_count) + rng.normal(0, 40, mean.shape)) / per_count
    pixels = np.clip(np.rint(counts), 0, (1 << bits) - 1).astype(np.uint8 if bits == 8 else np.uint16)
    return Frame("front", 0, 0, pixels, bits)


@pytest.mark.parametrize("order", [1.0, 2.0])
@pytest.mark.parametrize("bits", [8, 12, 16])
def test_on_clean_spots_it_agrees_with_the_profile(order: float, bits: int) -> None:
    rng = np.random.default_rng(bits)
    apart = []
    for diameter in (16.0, 30.0, 44.0, 60.0):
        for ratio, angle in ((1.0, 0.0), (1.4, 0.5), (2.2, 1.2)):
            u, v = rng.uniform((190, 150), (210, 170))
            mean = super_gaussian(u, v, (diameter * ratio, diameter), angle, order, bits)
            pair = []
            for _ in range(2):
                picture = exposed(mean, bits, rng)
                spot, second = locate(picture), found(locate_ellipse(picture))
                assert isinstance(spot, Spot)
                assert np.hypot(second.u_px - u, second.v_px - v) < 5 * second.sigma_px
                pair.append((spot.u_px - second.u_px, spot.v_px - second.v_px))
            apart.append(np.mean(pair, axis=0))
    assert np.sqrt(np.mean(np.square(apart))) < 0.01  # App. A.4


def test_a_spot_on_a_plain_target_is_as_wide_as_its_light() -> None:
    """Half a 1/e² diameter is two sigmas: 13 × 5 mm at 0.25 mm/px."""
    spot = Blob(370.3, 241.6, 52.0, 20.0, 0.3)
    profile = fitted_profile(frame(200 * light(spot), bits=16, background=800.0), SpotSettings(), None)
    assert profile is not None
    assert profile.order == pytest.approx(1.0, abs=0.02)
    a, b, c, _ = astuple(profile.shape)
    narrow, wide = np.linalg.eigvalsh(np.linalg.inv([[a, b], [b, c]]))
    assert (narrow, wide) == pytest.approx(((20 / 4) ** 2, (52 / 4) ** 2), abs=0.3)


def test_opencv_fits_about_the_same_ellipse_to_whole_pixels() -> None:
    rng = np.random.default_rng(4)
    apart = []
    for _ in range(20):
        u, v = rng.uniform(80, 88, 2)
        picture = photographed(light(Blob(u, v, 60, 40, 0.5), width=SIZE, height=SIZE), rng)
        smooth = cv2.GaussianBlur(picture.pixels.astype(np.float32) - 8, (0, 0), 4.0)
        above = (smooth > smooth.max() / 2).astype(np.uint8)
        outlines, _ = cv2.findContours(above, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        (x, y), _, _ = cv2.fitEllipse(outlines[0])
        second = found(locate_ellipse(picture))
        apart.append((second.u_px - x, second.v_px - y))
    assert np.sqrt(np.mean(np.square(apart))) < 0.05  # limit of whole pixels


def test_a_ghost_beside_the_spot_draws_the_two_localisers_apart() -> None:
    rng = np.random.default_rng(5)
    clean, ghost = Blob(375.3, 240.6), Blob(397.0, 240.6, 30.0, peak=20.0)
    for blobs, distorted in (((clean,), False), ((clean, ghost), True)):
        picture = photographed(light(*blobs), rng)
        spot, second = locate(picture), found(locate_ellipse(picture))
        apart = np.hypot(spot.u_px - second.u_px, spot.v_px - second.v_px)
        assert (apart > 10 * np.hypot(spot.sigma_px, second.sigma_px)) == distorted


def test_where_there_is_no_spot_there_is_no_ellipse() -> None:
    assert locate_ellipse(frame(np.zeros((HEIGHT, WIDTH)))) is None


def test_a_flat_that_is_dark_under_the_spot_leaves_no_ellipse() -> None:
    response = np.ones((SIZE, SIZE))
    response[40:130, 40:130] = 0
    picture = frame(light(Blob(84.0, 84.0), width=SIZE, height=SIZE), np.random.default_rng(6), 0.7)
    assert locate_ellipse(picture, flat=Flat.from_response(response, "recording")) is None


SHAPES = [(1.0, 1.0, 0.0), (1.2, 0.7, 0.4), (1.3, 0.5, 2.5), (0.6, 1.6, 1.0)]


def points(
    first: float, second: float, angle: float, centre: tuple[float, float], count: int = 90
) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 2) of an ellipse, unevenly spaced, and the outer normals there."""
    around = np.linspace(0, 2 * np.pi, count, endpoint=False)
    around += 0.2 * np.sin(2 * around)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    on = np.stack([first * np.cos(around), second * np.sin(around)], axis=1)
    normals = np.stack([np.cos(around) / first, np.sin(around) / second], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return on @ turn.T + centre, normals @ turn.T


@pytest.mark.parametrize(("first", "second", "angle"), SHAPES)
def test_the_centre_of_an_exact_ellipse_is_exact(first: float, second: float, angle: float) -> None:
    for centre in ((0.0, 0.0), (0.05, -0.08)):
        on, _ = points(first, second, angle, centre)
        fitted = fit_conic(*on.T)
        assert (fitted.x, fitted.y) == pytest.approx(centre, abs=1e-10)


@pytest.mark.parametrize(("first", "second", "angle"), SHAPES)
def test_noisy_points_give_the_centre_that_opencv_finds(first: float, second: float, angle: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        on, _ = points(first, second, angle, (0.02, 0.03))
        on += rng.normal(0, 0.02, on.shape)
        on -= on.mean(axis=0)
        fitted = fit_conic(*on.T)
        (x, y), _, _ = cv2.fitEllipseDirect((100 * on).astype(np.float32))
        assert (100 * fitted.x, 100 * fitted.y) == pytest.approx((x, y), abs=0.01)


@pytest.mark.parametrize(("first", "second", "angle"), SHAPES)
def test_sensitivities_say_how_a_point_moves_the_centre(first: float, second: float, angle: float) -> None:
    on, normals = points(first, second, angle, (0.02, -0.03))
    fitted = fit_conic(*on.T)
    step = 1e-5
    for index in range(0, len(on), 7):
        moved = on.copy()
        moved[index] += step * normals[index]
        again = fit_conic(*moved.T)
        shift = (again.x - fitted.x, again.y - fitted.y)
        assert fitted.sensitivities[:, index] * step == pytest.approx(shift, abs=2e-3 * step / 10)


@pytest.mark.parametrize(("first", "second", "angle"), SHAPES)
def test_sensitivities_predict_what_noise_does(first: float, second: float, angle: float) -> None:
    rng = np.random.default_rng(2)
    on, normals = points(first, second, angle, (0.0, 0.0))
    exact = fit_conic(*on.T)
    noise = 0.01
    centres = []
    for _ in range(600):
        fitted = fit_conic(*(on + noise * rng.standard_normal(len(on))[:, None] * normals).T)
        centres.append((fitted.x, fitted.y))
    expected = noise * np.sqrt(np.square(exact.sensitivities).sum(axis=1))
    assert np.sqrt(np.mean(np.square(centres), axis=0)) / expected == pytest.approx(1.0, abs=0.3)


def test_points_on_a_line_are_no_ellipse() -> None:
    along = np.linspace(-1, 1, 20)
    assert fit_conic(along, np.zeros(20)) is None


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
    spot = locate(shot, flat=Flat.from_response(response, "recording"))
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
        spot = locate(shot, flat=Flat.from_response(response, "recording"))
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
        assert (spot.u_px, spot.v_px) == pytest.approx((u_px, v_px), abs=0.3)
