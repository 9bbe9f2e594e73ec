"""Lights in any order: which are LEDs, which are not, and the similarity by which the LEDs moved."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support import evidence
from support.frames import HEIGHT, WIDTH, Blob, frame, light
from support.led_frames import LEDS, Motion

from altd.records import Frame
from altd.selfcheck import drift
from altd.selfcheck.drift import Fitted, chi2_limit, fit_similarity
from altd.selfcheck.lights import FrameFault, Lights, findings
from altd.selfcheck.matching import match
from altd.selfcheck.records import DriftLimits, LedView, Similarity

LEDS_PX = np.array([(120.0, 80.0), (640.0, 80.0), (640.0, 400.0), (120.0, 400.0)])
DRAWN = tuple(Blob(u, v, 14.0, peak=120.0) for u, v in LEDS_PX)
SPOT = Blob(330.0, 250.0, 40.0, peak=160.0)
COUNT = 4


def shots(alter: Callable[[int], tuple[Blob, ...]] = lambda number: (SPOT,)) -> list[Frame]:
    """Twelve exposures, the LEDs on from the fifth to the eighth; ``alter`` gives the other lights."""
    rng = np.random.default_rng(4)
    taken = []
    for number in range(3 * COUNT):
        leds = DRAWN if COUNT <= number < 2 * COUNT else ()
        one = frame(light(*leds, *alter(number)), rng, sequence=number, t_ns=number * 50_000_000)
        taken.append(replace(one, exposure_ms=1.6, gain_db=0.0))
    return taken


def found(taken: list[Frame]) -> tuple[FrameFault, ...]:
    return findings(taken[:COUNT], taken[COUNT : 2 * COUNT], taken[2 * COUNT :], LEDS_PX)


def test_a_steady_spot_under_noise_and_leds_that_follow_are_nothing() -> None:
    assert found(shots()) == ()


def test_a_spot_that_trembles_is_nothing() -> None:
    rng = np.random.default_rng(1)
    jitter = rng.normal(0, 1.5, (12, 2))
    assert found(shots(lambda n: (replace(SPOT, u_px=330 + jitter[n, 0], v_px=250 + jitter[n, 1]),))) == ()


def test_without_a_beam_there_is_nothing_either() -> None:
    assert found(shots(lambda number: ())) == ()


@pytest.mark.parametrize("flashes", [{2}, {0, 1, 9}, {5}, {1, 6}])
def test_a_light_that_comes_or_goes_by_itself_is_named(flashes: set[int]) -> None:
    blinker = Blob(480.0, 160.0, 16.0, peak=100.0)
    said = found(shots(lambda number: (SPOT, blinker) if number in flashes else (SPOT,)))
    assert said
    assert all("u 480 v 160 px appeared or vanished without the LEDs" in finding.sentence for finding in said)
    assert not any(finding.spoils for finding in said)


def test_near_an_led_it_spoils_the_check() -> None:
    flash = Blob(648.0, 82.0, 14.0, peak=100.0)
    said = found(shots(lambda number: (SPOT, flash) if number == 6 else (SPOT,)))
    assert [finding.spoils for finding in said] == [True]
    assert "near an LED" in said[0].sentence


def test_a_beam_that_jumps_is_told() -> None:
    said = found(shots(lambda number: (SPOT if number < 6 else replace(SPOT, u_px=500.0),)))
    assert any("appeared or vanished without the LEDs" in finding.sentence for finding in said)


def test_a_picture_that_comes_again_is_no_exposure() -> None:
    taken = shots()
    taken[6] = replace(taken[6], pixels=taken[1].pixels)
    said = found(taken)
    assert [finding.spoils for finding in said] == [True]
    words = "the camera repeats a picture: 100% of the picture is that of exposure 1"
    assert said[0].sentence.startswith(words)


@pytest.mark.parametrize("change", [{"exposure_ms": 1.9}, {"gain_db": 1.0}, {"exposure_ms": None}])
def test_frames_of_two_exposures_are_not_compared(change: dict[str, float | None]) -> None:
    taken = shots()
    taken[7] = replace(taken[7], **change)  # type: ignore[arg-type]
    assert found(taken) == (FrameFault("the exposure was changed during the check", spoils=True),)


def bright(lights: np.ndarray) -> np.ndarray:
    return np.full(len(lights), 100.0)


@pytest.mark.parametrize("missing", [(), (3,), (0, 5), (0, 1, 2), (1, 3, 4)])
@pytest.mark.parametrize("motion", [Motion(), Motion(0.3, -0.2, 0.05), Motion(25, -18, 2.0, 9000)])
def test_each_led_finds_its_light_though_some_are_dark(missing: tuple[int, ...], motion: Motion) -> None:
    order = [led for led in np.random.default_rng(1).permutation(6) if led not in missing]
    lights = motion.of(LEDS)[order]
    found = match(LEDS, lights, bright(lights)).lights
    assert [order[light] if light >= 0 else None for light in found] == [
        None if led in missing else led for led in range(6)
    ]


def test_reflections_are_no_leds() -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        foreign = rng.uniform((0, 0), (752, 480), (8, 2))
        foreign = foreign[np.hypot(*(foreign[:, None] - LEDS[None]).transpose(2, 0, 1)).min(axis=1) > 12]
        lights = np.concatenate([foreign, Motion(1.2, 0.4, 0.3).of(LEDS[[0, 2, 4, 5]])])
        found = match(LEDS, lights, bright(lights))
        first = len(foreign)
        assert found.lights.tolist() == [first, -1, first + 1, -1, first + 2, first + 3]
        assert not found.rival


@pytest.mark.parametrize(
    "motion", [Motion(60, -50), Motion(turn_deg=12), Motion(turn_deg=180), Motion(-45, 10, -90, 150_000)]
)
@pytest.mark.parametrize("missing", [(), (3,), (0, 5)])
def test_a_layout_that_is_far_from_its_place_is_found_there(motion: Motion, missing: tuple[int, ...]) -> None:
    """A camera that was knocked, or another one: upside down, each LED is where half a turn brings it."""
    seen = [led for led in range(6) if led not in missing]
    dim = np.array([(60.0, 240.0), (500.0, 100.0)])
    lights = np.concatenate([dim, motion.of(LEDS)[seen]])
    found = match(LEDS, lights, np.array([20.0, 20.0] + [100.0] * len(seen)))
    assert found.lights.tolist() == [2 + seen.index(led) if led in seen else -1 for led in range(6)]
    assert not found.rival


def test_lights_that_lie_as_they_like_are_no_layout_anywhere() -> None:
    """By chance some of these lie like three LEDs, moved, turned and scaled, and none like four."""
    rng = np.random.default_rng(7)
    for count in (3, 6, 12, 40):
        for _ in range(50):
            lights = rng.uniform((0, 0), (752, 480), (count, 2))
            assert (match(LEDS, lights, rng.uniform(20, 100, count)).lights >= 0).sum() <= 3


def test_leds_of_a_target_behind_are_not_taken_for_those_of_this_one() -> None:
    lights = Motion(30, -20, 1.0, -350_000).of(LEDS)
    assert (match(LEDS, lights, bright(lights)).lights < 0).all()


def test_a_symmetric_layout_of_which_half_is_dark_is_matched_without_a_turn() -> None:
    symmetric = np.array([(100, 60), (370, 20), (640, 60), (100, 420), (370, 460), (640, 420)], dtype=float)
    for lit in itertools.combinations(range(6), 3):
        lights = symmetric[list(lit)] + (0.4, -0.3)
        found = match(symmetric, lights, bright(lights)).lights
        assert [led for led in range(6) if found[led] >= 0] == list(lit)


def test_two_pictures_of_the_layout_leave_open_which_is_the_right_one() -> None:
    ghost = np.concatenate([LEDS, np.add(LEDS, (14.0, 3.0))])
    assert match(LEDS, ghost, bright(ghost)).rival
    dim = np.repeat([100.0, 20.0], 6)
    assert not match(LEDS, ghost, dim).rival
    assert match(LEDS, ghost, dim).lights.tolist() == list(range(6))


@pytest.mark.parametrize("lights", [np.empty((0, 2)), LEDS[:1], LEDS[:2]])
def test_of_fewer_than_three_only_those_in_their_places_count(lights: np.ndarray) -> None:
    assert (match(LEDS, lights, bright(lights)).lights >= 0).sum() == len(lights)
    assert (match(LEDS, lights + 5.0, bright(lights)).lights < 0).all()


ABOUT = LEDS.mean(axis=0)
RADIUS_PX = float(np.sqrt(np.mean(np.sum((LEDS - ABOUT) ** 2, axis=1))))


def fitted(then: np.ndarray, now: np.ndarray, sigma: np.ndarray) -> Fitted:
    return fit_similarity(then, now, sigma, ABOUT, RADIUS_PX)


@pytest.mark.parametrize("motion", [Motion(), Motion(0.3, -0.1, 0.05, -400), Motion(-9, 4, -3, 20_000)])
@pytest.mark.parametrize("used", [range(6), (0, 2, 5)])
def test_what_moved_is_found_about_the_centroid_of_all_references(motion: Motion, used: object) -> None:
    rows = list(used)  # type: ignore[call-overload]
    found = fitted(LEDS[rows], motion.of(LEDS)[rows], np.full(len(rows), 0.01)).similarity
    assert found.shift_px == pytest.approx((motion.u_px, motion.v_px), abs=1e-9)
    assert found.turn_deg == pytest.approx(motion.turn_deg, abs=1e-9)
    assert found.scale_ppm == pytest.approx(motion.scale_ppm, abs=1e-5)
    anywhere = np.array([[10.0, 20.0], [700.0, 100.0]])
    assert found.now_px(anywhere) == pytest.approx(motion.of(anywhere), abs=1e-9)
    assert found.then_px(found.now_px(anywhere)) == pytest.approx(anywhere, abs=1e-9)


def test_the_covariance_is_that_of_many_checks_with_noise_of_each_led() -> None:
    rng = np.random.default_rng(3)
    sigma = np.array([0.01, 0.03, 0.01, 0.05, 0.01])
    then = LEDS[:5]
    found = []
    chi2 = []
    place = np.array([[80.0, 300.0]])
    places = []
    for _ in range(4000):
        result = fitted(then, then + rng.normal(0, sigma[:, None], then.shape), sigma)
        found.append(result.similarity.vector)
        chi2.append(result.chi2)
        places.append(result.similarity.now_px(place)[0])
    example: Similarity = result.similarity
    assert np.std(found, axis=0) == pytest.approx(np.sqrt(np.diag(example.covariance)), rel=0.05)
    distances = np.einsum("ni,ij,nj->n", found, np.linalg.inv(example.covariance), found)
    assert np.mean(distances) == pytest.approx(4, rel=0.05)
    assert np.mean(chi2) == pytest.approx(2 * 5 - 4, rel=0.05)
    expected = example.covariance_at_px2(80.0, 300.0)
    assert np.cov(np.array(places).T) == pytest.approx(expected, rel=0.1, abs=5e-6)


@pytest.mark.parametrize("freedom", [2, 8, 20])
def test_the_chi2_limit_is_exceeded_as_rarely_as_three_sigmas(freedom: int) -> None:
    draws = np.random.default_rng(4).chisquare(freedom, 2_000_000)
    assert np.mean(draws > chi2_limit(freedom, 3.0)) == pytest.approx(1.35e-3, rel=0.15)


def test_without_freedom_nothing_can_disagree() -> None:
    assert chi2_limit(0, 4.5) == float("inf")


def test_three_leds_on_the_pixel_raster_do_not_feign_a_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each LED's place is off by 0.0025 px rms, the same in all pairs: χ² (4) exceeds 18.5 in 0.1 %."""
    rng = np.random.default_rng(8)
    empty = Frame("camera", 0, 0, np.zeros((HEIGHT, WIDTH), np.uint8), 8)
    view = LedView((replace(empty, leds_on=True),) * 2, (empty,) * 2)
    calibrated = replace(evidence.target("front"), leds_px=LEDS[:3])
    squares = []
    for _ in range(30):
        off_px = rng.normal(0.0, 0.0025, (3, 2))

        def lights(*_: object, off_px: np.ndarray = off_px) -> Lights:
            places = LEDS[:3] + off_px + rng.normal(0.0, 0.001, (3, 2))
            return Lights(places, np.full(3, 0.001), np.full(3, 180.0), np.full(3, 18.0))

        monkeypatch.setattr(drift, "lights_of", lights)
        found = drift.drift_of("front", view, calibrated, DriftLimits())
        assert found.significance is not None
        squares.append(found.significance**2)
    assert max(squares) < 18.5
    assert np.mean(squares) > 1.0
