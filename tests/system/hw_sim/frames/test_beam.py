import math

import numpy as np
import pytest

from hw_sim.beam import BeamPose, Footprint, Laser, footprint

STEP_MM = 0.05
AXIS = np.arange(-25.0, 25.0, STEP_MM, dtype=np.float32)
X, Y = np.meshgrid(AXIS, AXIS)


def second_moment_width_mm(spot: Footprint, axis: int) -> float:
    """4 sigma along x (0) or y (1), which is the 1/e² diameter of a Gaussian (ISO 11146)."""
    along = (X, Y)[axis].astype(np.float64)
    weight = spot.irradiance(X, Y).astype(np.float64)
    return 4.0 * math.sqrt(float((along**2 * weight).sum() / weight.sum()))


@pytest.mark.parametrize("order", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.11, 0.25)])
def test_all_the_power_arrives_however_the_beam_falls(order: float, slopes: tuple[float, float]) -> None:
    spot = footprint(Laser(power_mw=3.0, diameters_mm=(12.0, 7.0), order=order), BeamPose(0, 0, *slopes), 0.0)
    assert float(spot.irradiance(X, Y).sum(dtype=np.float64)) * STEP_MM**2 == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize("order", [1.0, 3.0])
def test_the_stated_diameters_are_where_the_irradiance_is_down_to_one_over_e_squared(order: float) -> None:
    spot = footprint(Laser(diameters_mm=(12.0, 6.0), angle_rad=math.pi / 2, order=order), BeamPose(0, 0), 0.0)
    here = np.array([0.0, 0.0, 3.0], dtype=np.float32), np.array([0.0, 6.0, 0.0], dtype=np.float32)
    peak, along, across = spot.irradiance(*here)
    assert along / peak == pytest.approx(math.exp(-2.0), rel=1e-4)
    assert across / peak == pytest.approx(math.exp(-2.0), rel=1e-4)


def test_an_oblique_beam_elongates_by_one_over_cos_in_its_plane_only() -> None:
    slope = 0.25
    spot = footprint(Laser(diameters_mm=(10.0, 10.0)), BeamPose(0.0, 0.0, slope, 0.0), 0.0)
    assert second_moment_width_mm(spot, 0) == pytest.approx(10.0 * math.sqrt(1.0 + slope**2), rel=1e-4)
    assert second_moment_width_mm(spot, 1) == pytest.approx(10.0, rel=1e-4)


def test_the_box_leaves_nothing_visible_outside() -> None:
    spot = footprint(Laser(diameters_mm=(14.0, 6.0), angle_rad=0.7), BeamPose(0.0, 0.0, 0.1, 0.2), 0.0)
    half_x, half_y = spot.half_box_mm
    outside = (np.abs(X) > half_x) | (np.abs(Y) > half_y)
    assert spot.irradiance(X, Y)[outside].max() < 1.1e-6 * spot.peak_mw_per_mm2


def test_a_pose_tells_its_angles_and_where_it_meets_a_plane() -> None:
    pose = BeamPose(10.0, -5.0, 0.02, -0.03)
    assert pose.at(280.0) == pytest.approx((15.6, -13.4))
    assert (pose.yaw_deg, pose.pitch_deg) == pytest.approx((1.14576, -1.71836), abs=1e-5)
