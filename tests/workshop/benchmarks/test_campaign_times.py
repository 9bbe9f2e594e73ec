"""The ways of ``make campaign`` that disturb times and numbers, held against arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.campaign.way import CAMERAS, Draw, Way
from benchmarks.campaign.ways import numbers, times
from benchmarks.campaign.ways.numbers import Misnumbered
from benchmarks.campaign.ways.times import MS, Delivery, Mistimed


def draw(seed: int = 0) -> Draw:
    return Draw(np.random.default_rng(seed))


DELIVERIES = [
    Delivery(camera, k * 50 * MS, k, k * 50 * MS, k * 50 * MS + 5 * MS)
    for k in range(40)
    for camera in CAMERAS
]


@pytest.mark.parametrize("way", times.WAYS.ways, ids=lambda way: way.name)
def test_a_way_of_times_touches_nothing_before_its_onset(way: Way) -> None:
    changed = way.name == "clean_times"
    for seed in range(6):
        mistimed = way.make(draw(seed))
        assert isinstance(mistimed, Mistimed)
        after = mistimed.change(DELIVERIES, 500 * MS)
        assert [one for one in after if one.true_ns < 500 * MS] == DELIVERIES[
            :20
        ] or mistimed.note.startswith("of ")
        changed |= sorted(after, key=str) != sorted(DELIVERIES, key=str)
    assert changed


def test_a_held_process_gets_what_the_drivers_kept_and_then_new_frames() -> None:
    for seed in range(6):
        mistimed = times.process_held(draw(seed))
        after = mistimed.change(DELIVERIES, 500 * MS)
        during = [one for one in after if 0 <= one.true_ns - 500 * MS < mistimed.held_ns]
        assert all(one.arrives_ns == 500 * MS + mistimed.held_ns for one in during)
        assert len(during) <= 2 * int(mistimed.note.split()[2])


def test_numbers_that_are_none_are_drawn_for_config_and_calibration() -> None:
    drawn = [way.make(draw(seed)) for way in numbers.WAYS.ways for seed in range(20)]
    assert all(isinstance(one, Misnumbered) for one in drawn)
    assert {one.is_none for one in drawn if isinstance(one, Misnumbered)} == {True, False}
