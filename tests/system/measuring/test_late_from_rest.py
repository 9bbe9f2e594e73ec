"""A camera that delivers whole frames late, from the first motion after a rest on."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from support.located import located
from support.measurements import beam_chain
from support.played_unit import PlayedUnit
from support.recordings import place_px

from altd.calibration.file import load_calibration
from altd.config import Measuring
from altd.measuring.calibration import Calibration
from altd.measuring.pairing import Pair
from altd.records import Measurement, Spot

PERIOD_S = 0.05
REST_S = 3.02
NOISE_PX = 0.04
SLOPES = np.array([0.02, -0.03])
Course = Callable[[float], float]
"""Millimetres by seconds."""


@pytest.fixture(scope="module")
def calibration(played_unit: PlayedUnit) -> Calibration:
    return load_calibration(played_unit.calibration)


def course(speed_mm_per_s: float, within_s: float) -> Course:
    """Rest, then even acceleration to a speed within a time."""

    def moved_mm(t_s: float) -> float:
        since_s = max(t_s - REST_S, 0.0)
        if since_s < within_s:
            return 0.5 * speed_mm_per_s / within_s * since_s**2
        return speed_mm_per_s * (since_s - within_s / 2)

    return moved_mm


def beam(along: Sequence[float], moved_mm: float, pivot_mm: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Place on the front target and slopes, moved along a direction, or turned about a pivot at z."""
    way = np.array(along) * moved_mm
    if pivot_mm is None:
        return np.array([-15.0, -12.0]) + way, SLOPES
    return np.array([-5.0, -5.0]) - way * pivot_mm / 280.0, SLOPES + way / 280.0


def measured(
    calibration: Calibration,
    at: Callable[[float], tuple[np.ndarray, np.ndarray]],
    late: dict[str, int],
    count: int = 110,
    seed: int = 1,
) -> list[Measurement]:
    """The measurements of spots with the noise of clean frames, each camera's so many exposures late."""
    rng = np.random.default_rng(seed)
    chain = beam_chain(calibration, Measuring())
    measurements = []
    for number in range(count):
        items = {}
        for target, z_mm in (("front", 0.0), ("rear", 280.0)):
            place, slopes = at((number - late.get(target, 0)) * PERIOD_S)
            u, v = np.array(place_px(target, *(place + z_mm * slopes))) + rng.normal(0, NOISE_PX, 2)
            one = located(target, number, round(number * PERIOD_S * 1e9))
            spot = Spot(float(u), float(v), NOISE_PX, 44.0, 150.0)
            items[target] = replace(one, spot=spot, found=spot)
        pair = Pair(number, items["front"].t_ns, 0, items, {}, dict.fromkeys(items, 0))
        measurements += [one for one in [chain.add(pair)] if one is not None]
    return measurements


def worst_sigmas(measurements: Sequence[Measurement], truth_of: Callable[[float], np.ndarray]) -> float:
    """The largest error of yaw and pitch of a valid measurement, in sigmas.

    Of those in whose mean no exposure is missing: which ones are, the measurement does not show.
    """
    worst = 0.0
    for one in measurements:
        if one.valid and one.frames == 20:
            truth = np.mean([truth_of(one.t_ns * 1e-9 + (k - 9.5) * PERIOD_S) for k in range(20)], axis=0)
            for value, true in zip((one.values["yaw_deg"], one.values["pitch_deg"]), truth, strict=True):
                assert value.sigma is not None
                worst = max(worst, abs(value.value - float(true)) / value.sigma)
    return worst


ALONG = [(1.0, 0.0), (0.0, -1.0), (0.6, 0.8)]


@pytest.mark.parametrize("along", ALONG)
@pytest.mark.parametrize("speed", [1.0, 3.0, 10.0])
@pytest.mark.parametrize("late", [{"rear": 1}, {"rear": 2}, {"front": 1}])
def test_no_valid_value_errs_beyond_four_sigma(
    calibration: Calibration, late: dict[str, int], speed: float, along: tuple[float, float]
) -> None:
    """The machine shifts: yaw and pitch do not change, whatever window is looked at."""
    for within_s in (0.05, 0.5, 2.0):
        path = course(speed, within_s)
        got = measured(calibration, lambda t_s: beam(along, path(t_s), None), late)  # noqa: B023
        assert worst_sigmas(got, lambda t_s: np.degrees(np.arctan(SLOPES))) < 4.0


@pytest.mark.parametrize("pivot_mm", [0.0, -2000.0])
@pytest.mark.parametrize("speed", [1.0, 3.0, 10.0])
def test_nor_does_one_of_a_machine_that_turns(
    calibration: Calibration, speed: float, pivot_mm: float
) -> None:
    """About the front target, whose spot then shows nothing, and about a distant point."""
    path = course(speed * (0.12 if pivot_mm else 1.0), 0.5)

    def at(t_s: float) -> tuple[np.ndarray, np.ndarray]:
        return beam((0.6, 0.8), path(t_s), pivot_mm)

    got = measured(calibration, at, {"rear": 1})
    assert worst_sigmas(got, lambda t_s: np.degrees(np.arctan(at(t_s)[1]))) < 4.0


@pytest.mark.parametrize("along", ALONG)
@pytest.mark.parametrize("speed", [0.5, 2.0, 10.0])
@pytest.mark.parametrize("pivot_mm", [None, -2000.0, 140.0])
def test_cameras_in_step_measure_the_same_motions(
    calibration: Calibration, pivot_mm: float | None, speed: float, along: tuple[float, float]
) -> None:
    """Valid but for the windows that a jump makes unsteady, and with the sigma of rest in the end."""
    path = course(speed if pivot_mm is None else 0.12 * speed, 0.5)

    def at(t_s: float) -> tuple[np.ndarray, np.ndarray]:
        return beam(along, path(t_s), pivot_mm)

    got = measured(calibration, at, {})
    refused = [one for one in got[10:] if not one.valid]
    assert len(refused) <= 6
    assert worst_sigmas(got, lambda t_s: np.degrees(np.arctan(at(t_s)[1]))) < 4.0
    if speed >= 2.0 and pivot_mm is None:
        sigma = [one.values["pitch_deg"].sigma for one in (got[40], got[-1])]
        assert sigma[1] < 1.5 * sigma[0]
