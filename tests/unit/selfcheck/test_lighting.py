"""Frames drawn by hand, and lights in any order: what speaks against them, and which of them are LEDs."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.frames import Blob, frame, light
from support.led_frames import LEDS, Motion

from altd.records import Frame
from altd.selfcheck.lights import Finding, findings
from altd.selfcheck.matching import match

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


def found(taken: list[Frame]) -> tuple[Finding, ...]:
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
    assert found(taken) == (Finding("the exposure was changed during the check", spoils=True),)


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
