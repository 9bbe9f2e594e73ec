"""Light that changes on one target alone, against the size of the change."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from altd.measuring.light_balance import LightBalance
from altd.records import FloatArray, MeanSpots, SpotShape

RADIUS_PX = 20.0
ROUND = SpotShape(4 / RADIUS_PX**2, 0.0, 4 / RADIUS_PX**2, 1.0)
SECOND = 10**9
FRAMES = 20
RANDOM = np.random.default_rng(27)


def mean(
    t_s: float,
    front: FloatArray | float = 1000.0,
    rear: FloatArray | float = 800.0,
    at_radii: tuple[float, float] = (0.0, 0.0),
    noise: float = 0.005,
) -> MeanSpots:
    """A window of exposures whose spots have that light, ``noise`` of it too."""
    lights = np.stack(np.broadcast_arrays(front, rear, np.ones(FRAMES))[:2], axis=1)
    logs = np.log(lights) + RANDOM.normal(0.0, noise, lights.shape)
    px = np.full((2, 2), 300.0) + RADIUS_PX * np.array(at_radii)
    return MeanSpots(
        ("front", "rear"),
        px,
        np.eye(4),
        round(t_s * SECOND),
        FRAMES,
        0,
        shapes=(ROUND, ROUND),
        log_lights=np.stack([logs, np.full_like(logs, noise)], axis=2),
    )


def after(balance: LightBalance, *means: MeanSpots, is_valid: bool = True) -> float:
    """The change of the rear target after these windows."""
    changed: tuple[float, ...] = ()
    for each in means:
        changed = balance.changed_light(each)
        if is_valid:
            balance.update(replace(each, changed_light=changed))
    assert changed[0] == 0.0
    return changed[1]


def test_light_that_stays_or_changes_on_both_targets_has_not_changed() -> None:
    balance = LightBalance()
    for t_s in range(100):
        power = 1.0 if t_s < 50 else 0.1
        assert after(balance, mean(t_s, 1000.0 * power, 800.0 * power)) == 0.0


@pytest.mark.parametrize("share", [2.0, 1.4, 0.7])
@pytest.mark.parametrize("target", ["front", "rear"])
def test_light_that_is_added_or_lost_on_one_target_is_seen(target: str, share: float) -> None:
    front, rear = (share * 1000.0, 800.0) if target == "front" else (1000.0, share * 800.0)
    changed = after(LightBalance(), mean(0.0), mean(1.0, front, rear))
    assert changed == pytest.approx(math.expm1(abs(math.log(share))), rel=0.15)


@pytest.mark.parametrize("frames", [1, 4, 16])
def test_the_part_of_a_window_that_is_disturbed_counts_from_its_first_exposure_to_its_last(
    frames: int,
) -> None:
    """The mean spot is displaced by that part too."""
    share = 0.4 * frames / FRAMES
    disturbed = np.where(np.arange(FRAMES) >= FRAMES - frames, 1.4 * 800.0, 800.0)
    for rear in (disturbed, disturbed[::-1]):
        changed = after(LightBalance(), mean(0.0), mean(0.5, rear=rear))
        assert 0.6 * share < changed < 1.1 * share


def test_a_second_light_that_stays_is_not_forgotten_within_ten_minutes_though_the_spots_vibrate() -> None:
    balance = LightBalance()
    after(balance, mean(0.0))
    for t_s in np.arange(1.0, 600.0):
        changed = after(balance, mean(t_s, rear=1000.0, at_radii=(0.2 * math.sin(t_s), 0.2 * math.cos(t_s))))
        assert changed > 0.18
    assert after(balance, mean(600.0)) < 0.04


def test_a_lens_that_darkens_towards_the_edge_changes_nothing_while_the_machine_drives() -> None:
    balance = LightBalance()
    for t_s in np.arange(0.0, 60.0, 0.5):
        at = 0.4 * t_s  # radii
        assert after(balance, mean(t_s, rear=800.0 * math.exp(-0.015 * at), at_radii=(at, 0.0))) == 0.0


def test_dust_of_weeks_is_no_change() -> None:
    balance = LightBalance()
    for hour in range(24 * 14):
        assert after(balance, mean(3600.0 * hour, rear=800.0 * math.exp(-0.001 * hour))) == 0.0


def test_noise_of_dim_spots_is_no_change() -> None:
    balance = LightBalance()
    assert max(after(balance, mean(t_s, noise=0.2)) for t_s in range(200)) == 0.0


def test_nothing_is_known_without_the_light_and_it_is_followed_again_when_it_comes_back() -> None:
    balance = LightBalance()
    after(balance, mean(0.0))
    assert balance.changed_light(mean(1.0, rear=math.nan)) == ()
    assert after(balance, mean(2.0, rear=1100.0)) > 0.3


def test_a_lamp_in_place_of_the_beam_changes_no_reference_and_the_beam_is_known_again() -> None:
    balance = LightBalance()
    after(balance, mean(0.0))
    for t_s in range(1, 600):
        assert after(balance, mean(t_s, front=20.0, at_radii=(9.0, 0.0)), is_valid=False) > 5.0
    assert after(balance, mean(600.0)) == 0.0


def test_a_change_that_stays_is_usual_after_hours_without_a_valid_measurement() -> None:
    """After a window was cleaned, for example."""
    balance = LightBalance()
    after(balance, mean(0.0))
    hours = [after(balance, mean(3600.0 * hour, rear=1200.0), is_valid=False) for hour in (0.1, 1, 2, 3)]
    assert hours[0] > 0.4
    assert hours == sorted(hours, reverse=True)
    assert hours[-1] == 0.0


def test_single_exposures_of_unknown_light_do_not_hide_a_change() -> None:
    rear = np.where(np.arange(FRAMES) % 3 == 0, np.nan, 1100.0)
    assert after(LightBalance(), mean(0.0), mean(1.0, rear=rear)) > 0.3


def test_a_window_whose_middle_is_set_back_by_outliers_is_compared_and_teaches_nothing() -> None:
    balance = LightBalance()
    after(balance, mean(100.0))
    for t_s in (99.6, 99.7, 99.5):
        assert after(balance, mean(t_s, rear=1100.0)) > 0.3


def test_a_recording_that_begins_again_has_another_reference() -> None:
    assert after(LightBalance(), mean(100.0), mean(0.0, rear=1100.0)) == 0.0
