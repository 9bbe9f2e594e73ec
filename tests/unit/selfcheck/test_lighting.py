"""Frames drawn by hand: what speaks against them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.frames import Blob, frame, light

from altd.records import Frame
from altd.selfcheck.lights import Finding, findings

LEDS_PX = np.array([(120.0, 80.0), (640.0, 80.0), (640.0, 400.0), (120.0, 400.0)])
LEDS = tuple(Blob(u, v, 14.0, peak=120.0) for u, v in LEDS_PX)
SPOT = Blob(330.0, 250.0, 40.0, peak=160.0)
COUNT = 4


def shots(alter: Callable[[int], tuple[Blob, ...]] = lambda number: (SPOT,)) -> list[Frame]:
    """Twelve exposures, the LEDs on from the fifth to the eighth; ``alter`` gives the other lights."""
    rng = np.random.default_rng(4)
    taken = []
    for number in range(3 * COUNT):
        leds = LEDS if COUNT <= number < 2 * COUNT else ()
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
    assert said[0].sentence.startswith(
        "the camera repeats a picture: 100% of the picture is that of exposure 1"
    )


@pytest.mark.parametrize("change", [{"exposure_ms": 1.9}, {"gain_db": 1.0}, {"exposure_ms": None}])
def test_frames_of_two_exposures_are_not_compared(change: dict[str, float | None]) -> None:
    taken = shots()
    taken[7] = replace(taken[7], **change)  # type: ignore[arg-type]
    assert found(taken) == (Finding("the exposure was changed during the check", spoils=True),)
