import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.frames import HEIGHT, WIDTH, Blob, frame, light

from altd.reasons import Reason
from altd.records import Frame, NoSpot, Spot
from altd.vision.flat import Flat
from altd.vision.image import SATURATED_FROM, clipped_from
from altd.vision.localise import locate
from altd.vision.search import coarse_image, fit_background
from altd.vision.settings import UNKNOWN_SPOT, SpotSettings


def found(outcome: Spot | NoSpot) -> Spot:
    assert isinstance(outcome, Spot), outcome
    return outcome


def reason(outcome: Spot | NoSpot) -> Reason:
    assert isinstance(outcome, NoSpot), outcome
    return outcome.reason


@settings(max_examples=40)
@given(
    u=st.floats(60, WIDTH - 61),
    v=st.floats(60, HEIGHT - 61),
    diameter=st.floats(18, 75),
    ratio=st.floats(0.4, 1.0),
    angle=st.floats(0, np.pi),
    bits=st.sampled_from([8, 10, 12, 16]),
)
def test_the_centroid_of_an_ellipse_without_noise_is_its_centre(u, v, diameter, ratio, angle, bits) -> None:
    scale = (1 << bits) / 256
    blob = Blob(u, v, diameter, max(diameter * ratio, 12), angle, peak=180 * scale)
    spot = found(locate(frame(light(blob), background=10 * scale, bits=bits)))
    rounding_px = 0.01 if bits == 8 else 0.0  # whole counts, and no noise that would spread them
    assert (spot.u_px, spot.v_px) == pytest.approx((u, v), abs=0.01 + rounding_px)


def test_the_diameter_is_the_one_over_e_squared_diameter() -> None:
    for diameter in (20.0, 44.0, 80.0):
        spot = found(locate(frame(light(Blob(300.3, 200.6, diameter)))))
        assert spot.diameter_px == pytest.approx(diameter, rel=0.04)


def test_the_peak_is_counted_over_the_background() -> None:
    spot = found(locate(frame(light(Blob(300, 200, peak=120)), background=40)))
    assert spot.peak == pytest.approx(120, abs=1.5)


def test_a_sloping_background_does_not_move_the_spot() -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    slope = 30 * u / WIDTH + 20 * v / HEIGHT
    spot = found(locate(frame(light(Blob(400.25, 222.75, peak=100)) + slope)))
    assert (spot.u_px, spot.v_px) == pytest.approx((400.25, 222.75), abs=0.05)


def test_hot_pixels_do_not_move_the_spot() -> None:
    rng = np.random.default_rng(2)
    clean = frame(light(Blob(300.5, 210.25)), rng)
    hot = clean.pixels.copy()
    hot[(210 + rng.integers(-20, 20, 6)), (300 + rng.integers(-20, 20, 6))] = 255
    hot[rng.integers(0, HEIGHT, 40), rng.integers(0, WIDTH, 40)] = 255
    before, after = found(locate(clean)), found(locate(replace(clean, pixels=hot)))
    assert np.hypot(after.u_px - before.u_px, after.v_px - before.v_px) < 0.15


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_noise_alone_is_no_spot(bits: int) -> None:
    rng = np.random.default_rng(3)
    scale = (1 << bits) / 256
    for noise in (0.5, 3, 30, 80):
        for _ in range(15):
            grey = rng.uniform(0, 150) * scale
            empty = frame(light(), rng, noise=noise * scale, background=grey, bits=bits)
            assert reason(locate(empty)) is Reason.SPOT_MISSING


def test_uniform_noise_over_the_whole_scale_is_no_spot() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        pixels = rng.integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
        assert reason(locate(replace(frame(light()), pixels=pixels))) is Reason.SPOT_MISSING


def test_a_black_frame_has_no_spot_and_a_white_one_is_saturated() -> None:
    assert reason(locate(frame(light(), background=0))) is Reason.SPOT_MISSING
    assert reason(locate(frame(light(), background=255))) is Reason.SATURATED


def test_two_equal_spots_are_ambiguous() -> None:
    rng = np.random.default_rng(5)
    for distance in (40, 60, 150, 300):
        blobs = Blob(250, 240), Blob(250 + distance, 250)
        assert reason(locate(frame(light(*blobs), rng))) is Reason.AMBIGUOUS, distance


def test_a_weak_reflection_does_not_make_a_frame_ambiguous() -> None:
    spot = found(locate(frame(light(Blob(250.5, 240.5), Blob(500, 300, peak=12)))))
    assert (spot.u_px, spot.v_px) == pytest.approx((250.5, 240.5), abs=0.02)


def test_a_spot_that_is_clipped_flat_is_saturated() -> None:
    assert reason(locate(frame(light(Blob(300, 200, peak=900))))) is Reason.SATURATED
    assert isinstance(locate(frame(light(Blob(300, 200, peak=240)))), Spot)


@pytest.mark.parametrize(("bits", "ceiling"), [(8, 235), (8, 250), (16, 4095), (16, 65520)])
def test_a_spot_that_is_clipped_below_full_scale_is_saturated_too(bits: int, ceiling: int) -> None:
    """As by a camera that delivers 12 bits in 16, or the grey values of video."""
    rng, scale = np.random.default_rng(bits * ceiling), ceiling / 255

    def clipped(peak: float) -> Frame:
        counts = scale * (light(Blob(300.3, 200.2, diameter_px=40.0, peak=peak)) + 8)
        counts += rng.normal(0, 2 * scale, counts.shape)
        step = 16 if ceiling == 65520 else 1  # the 12 bits may be the upper ones
        return frame(step * np.rint(np.minimum(counts, ceiling) / step), background=0, bits=bits)

    assert reason(locate(clipped(900))) is Reason.SATURATED
    spot = found(locate(clipped(320)))
    assert math.hypot(spot.u_px - 300.3, spot.v_px - 200.2) < 3 * spot.sigma_px
    assert found(locate(clipped(200))).diameter_px == pytest.approx(40, abs=1)


@pytest.mark.parametrize(("bits", "full_well"), [(8, 10_000), (8, 40_000), (12, 10_000)])
def test_no_beam_with_shot_noise_counts_as_clipped_below_full_scale(bits: int, full_well: int) -> None:
    """Gaussian, super-Gaussian and top hat, at four levels: equal values are few."""
    rng, full = np.random.default_rng(bits + full_well), 2**bits - 1
    v, u = np.mgrid[-30:31, -30:31] / 15
    squared = u**2 + v**2
    for shape in (np.exp(-2 * squared), np.exp(-(squared**4)), (squared < 1) * 1.0):
        for level in (0.3, 0.5, 0.7, 0.9):
            electrons = rng.poisson(shape * level * full_well)
            counts = electrons * full / full_well + rng.normal(0, 1, electrons.shape)
            pixels = np.clip(np.rint(counts), 0, full).astype(np.uint16)
            assert clipped_from(pixels[pixels > 0.5 * level * full], full) == SATURATED_FROM * full


@pytest.mark.parametrize(
    ("u", "v"), [(5, 200), (WIDTH - 8, 200), (300, 6), (300, HEIGHT - 4), (8, 9), (18, 240), (29, 240)]
)
def test_a_spot_at_the_edge_is_fitted_on_what_is_there(u: float, v: float) -> None:
    rng = np.random.default_rng(6)
    ratios = []
    for _ in range(30):
        at = u + rng.uniform(-1, 1), v + rng.uniform(-1, 1)
        grain = 1 + 0.1 * rng.standard_normal((HEIGHT, WIDTH))
        spot = found(locate(frame(light(Blob(*at)) * grain, rng)))
        sigma = np.hypot(spot.sigma_px, spot.excess_px)
        ratios.append(((spot.u_px - at[0]) / sigma, (spot.v_px - at[1]) / sigma))
    worse = np.sqrt(np.mean(np.square(ratios), axis=0)).max()
    assert 0.6 < worse < 1.4


def test_a_spot_at_the_edge_is_less_certain_than_a_whole_one() -> None:
    rng = np.random.default_rng(6)
    frames = (frame(light(Blob(u, 200)), rng) for u in (200.0, 4.0))
    whole, cut = (found(locate(each, reference=UNKNOWN_SPOT)) for each in frames)
    assert whole.excess_px == 0
    assert np.hypot(cut.sigma_px, cut.excess_px) > 2 * whole.sigma_px


@pytest.mark.parametrize(("u", "v"), [(-4, 200), (WIDTH + 6, 200), (300, -5), (300, HEIGHT + 3), (-2, -3)])
def test_a_spot_whose_middle_is_beyond_the_edge_is_cut(u: float, v: float) -> None:
    outcome = locate(frame(light(Blob(u, v)), np.random.default_rng(6)))
    assert reason(outcome) in (Reason.CUT_BY_EDGE, Reason.WRONG_SHAPE)


def test_a_spot_outside_the_size_limits_is_of_the_wrong_size() -> None:
    limits = SpotSettings(min_diameter_px=20, max_diameter_px=60)
    assert isinstance(locate(frame(light(Blob(300, 200, 40))), limits), Spot)
    for diameter in (12, 120):
        assert reason(locate(frame(light(Blob(300, 200, diameter))), limits)) is Reason.WRONG_SIZE


@pytest.mark.parametrize("bits", [8, 12, 16])
@pytest.mark.parametrize(("rows", "columns"), [(2, 2), (3, 3), (4, 4), (2, 1), (1, 2)])
def test_a_binned_picture_enlarged_to_its_old_size_is_distorted(rows: int, columns: int, bits: int) -> None:
    scale = ((1 << bits) - 1) / 255
    whole = frame(light(Blob(311.3, 207.9)) * scale, np.random.default_rng(8), 1.0 * scale, 8 * scale, bits)
    assert isinstance(locate(whole), Spot)
    small = cv2.resize(whole.pixels, (WIDTH // columns, HEIGHT // rows), interpolation=cv2.INTER_AREA)
    enlarged = cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
    assert reason(locate(replace(whole, pixels=enlarged))) is Reason.DISTORTED


def test_a_line_of_light_has_the_wrong_shape() -> None:
    assert reason(locate(frame(light(Blob(300, 200, 300, 24, 0.4))))) is Reason.WRONG_SHAPE


def test_frames_whose_size_is_no_multiple_of_a_cell_are_searched() -> None:
    spot = found(locate(frame(light(Blob(200.4, 150.6), width=333, height=301))))
    assert (spot.u_px, spot.v_px) == pytest.approx((200.4, 150.6), abs=0.02)


def test_the_same_scene_in_8_10_and_16_bits_gives_the_same_place() -> None:
    positions = []
    for bits in (8, 10, 16):
        scale = ((1 << bits) - 1) / 255
        rng = np.random.default_rng(7)
        spot = found(locate(frame(light(Blob(311.3, 207.9)) * scale, rng, 1.0 * scale, 8 * scale, bits)))
        positions.append((spot.u_px, spot.v_px))
    assert np.ptp(positions, axis=0).max() < 0.01


def test_sloping_light_behind_the_fall_off_of_a_lens_is_followed() -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    from_axis = np.hypot(u - WIDTH / 2 + 4, v - HEIGHT / 2 - 3) / 900.0  # in focal lengths
    falling = 60 / (1 + from_axis**2) ** 2 * (1 + 0.3 * u / WIDTH - 0.2 * v / HEIGHT)
    seen = frame(light() + falling, np.random.default_rng(1), noise=1.0, background=4.0)
    background = fit_background(coarse_image(seen.pixels)).levels((0.0, 0.0), (HEIGHT, WIDTH))
    off = background - falling - 4.0
    assert np.sqrt(np.mean(np.square(off))) < 0.15
    assert np.abs(off).max() < 0.8  # in a corner
    assert background[HEIGHT // 2, WIDTH // 2] - background[0, 0] > 10


def test_a_flat_tells_how_much_of_a_spot_lies_at_the_end_of_a_print() -> None:
    """Dots of 4 px, 9 px apart, that end at u 400; the light falls off to a half towards the borders."""
    v, u = np.mgrid[:480, :752].astype(float)
    dots = (np.hypot(u % 9 - 4, v % 9 - 4) < 3) & (u < 400)
    fall_off = 1 - 0.5 * ((u - 375) ** 2 + (v - 240) ** 2) / (375**2 + 240**2)
    flat = Flat.from_response((0.1 + dots) * fall_off, "recording")
    at = {inside: flat.hidden(400.0 - inside, 200.0, 56.0) for inside in (300, 45, 28, 14, 4, -20)}
    assert at[300] == at[45] == 0
    assert at[28] == pytest.approx(0.35, abs=0.2)
    assert at[14] == pytest.approx(0.85, abs=0.3)
    assert at[4] == at[-20] == 1
    whole = Flat.from_response((0.1 + (np.hypot(u % 9 - 4, v % 9 - 4) < 3)) * fall_off, "recording")
    assert not any(whole.hidden(*place, 56.0) for place in ((0, 0), (400, 200), (751, 479)))
