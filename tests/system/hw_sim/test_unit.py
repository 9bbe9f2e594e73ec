"""Simulated units beside others that differ in their seed or in one setting."""

import cv2
import numpy as np
import pytest

from hw_sim.beam import BeamPose
from hw_sim.faults import Fault
from hw_sim.motion import Drive, Vibration
from hw_sim.targets import DotPattern
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig


def test_the_same_seed_makes_the_same_unit_and_the_same_frames() -> None:
    first, second = (Unit(UnitConfig(seed=11)) for _ in range(2))
    for camera in CAMERAS:
        for exact in (True, False):
            frames = [unit.expose(camera, 3, 150_000_000, exact=exact).pixels for unit in (first, second)]
            assert np.array_equal(*frames)
        assert first.imagers[camera].view.lens.focal_mm == second.imagers[camera].view.lens.focal_mm


def test_without_dots_the_window_is_as_even_as_the_plate() -> None:
    for dots in (DotPattern(), None):
        bare = Unit(UnitConfig(seed=11, dots=dots, speckle_contrast=0.0))
        response = bare.imagers[FRONT].view.response
        ripple = float(np.std(response / cv2.GaussianBlur(response, (0, 0), 4.0)))
        assert ripple > 0.2 if dots else ripple < 1e-3


def test_stray_light_rises_with_the_lux_and_slopes_across_the_picture() -> None:
    dim, bright = (
        Unit(UnitConfig(seed=2, lux=lux, faults=frozenset({Fault.NO_LASER}))).expose(REAR, 0, 0).pixels
        for lux in (0.0, 1000.0)
    )
    assert dim.mean() == pytest.approx(4.0, abs=0.3)
    assert bright.mean() > 20.0
    quarters = [
        float(np.median(part)) for half in np.array_split(bright, 2) for part in np.array_split(half, 2, 1)
    ]
    assert max(quarters) > 1.1 * min(quarters)


def test_the_truth_is_told_with_and_without_vibration() -> None:
    shaking = Unit(UnitConfig(seed=2, vibration=Vibration(), drive=Drive()))
    still = Unit(UnitConfig(seed=2, drive=Drive()))
    shaking.place(BeamPose(3.0, 4.0, 0.01, 0.02))
    still.place(BeamPose(3.0, 4.0, 0.01, 0.02))
    t_ns = 7_350_000_000
    assert shaking.truth(t_ns, vibration=False) == still.truth(t_ns)
    assert 0.0 < abs(shaking.truth(t_ns).x_mm - still.truth(t_ns).x_mm) < 0.5


def test_coarser_dots_leave_the_lenses_and_the_plate_as_they_are() -> None:
    coarse = Unit(UnitConfig(seed=2, dots=DotPattern(0.8, 1.6)))
    fine = Unit(UnitConfig(seed=2))
    for camera in CAMERAS:
        assert coarse.imagers[camera].view.lens.focal_mm == fine.imagers[camera].view.lens.focal_mm
    assert not np.array_equal(coarse.imagers[FRONT].view.response, fine.imagers[FRONT].view.response)
    assert np.array_equal(coarse.imagers[REAR].view.response, fine.imagers[REAR].view.response)


def test_the_focal_lengths_can_be_chosen() -> None:
    unit = Unit(UnitConfig(seed=2, front_focal_mm=(12.0, 12.0), rear_focal_mm=(3.6, 3.6)))
    assert [unit.imagers[camera].view.lens.focal_mm for camera in CAMERAS] == [12.0, 3.6]
