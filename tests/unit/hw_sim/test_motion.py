from __future__ import annotations

import numpy as np
import pytest

from hw_sim.beam import BeamPose
from hw_sim.motion import Drive, Vibration, make_path, make_vibration
from hw_sim.stage import Stage

REST = BeamPose(1.0, 2.0, 0.01, 0.02)


def test_vibration_has_the_stated_rms_in_mm_and_mrad() -> None:
    shaking = make_vibration(Vibration(rms_mm=0.2, rms_mrad=0.5), np.random.default_rng(1))
    times_ns = np.random.default_rng(2).integers(0, 10**12, size=8000)
    poses = [shaking.moved(REST, int(t_ns)) for t_ns in times_ns]
    moved = np.array([(p.x_mm, p.y_mm, p.slope_x, p.slope_y) for p in poses])
    assert moved.std(axis=0) == pytest.approx([0.2, 0.2, 0.5e-3, 0.5e-3], rel=0.06)
    assert moved.mean(axis=0) == pytest.approx([1.0, 2.0, 0.01, 0.02], abs=0.02)


def test_the_machine_keeps_to_its_range_and_moves_slowly() -> None:
    drive = Drive(x_mm=18.0, period_s=60.0)
    moving = make_path(drive, np.random.default_rng(3))
    x_mm = np.array([moving.moved(REST, t * 50_000_000).x_mm for t in range(2400)]) - REST.x_mm
    assert 17.0 < np.abs(x_mm).max() <= 18.0
    assert np.abs(np.diff(x_mm)).max() / 0.05 <= 18.0 * 2.0 * np.pi / 60.0 * 1.001


def test_the_stage_misses_by_its_stated_error_and_points_straight() -> None:
    stage = Stage(np.random.default_rng(4), sigma_mm=0.002)
    poses = [stage.place(25.0, -50.0) for _ in range(2000)]
    errors = np.array([(p.x_mm - 25.0, p.y_mm + 50.0) for p in poses])
    assert errors.std(axis=0) == pytest.approx([0.002, 0.002], rel=0.1)
    assert {(p.slope_x, p.slope_y) for p in poses} == {(0.0, 0.0)}
