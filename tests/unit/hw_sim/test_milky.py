"""Light behind a window of milky glass, against the laws of optics."""

import math

import cv2
import numpy as np
import pytest

from hw_sim.beam import BeamPose, Footprint, Laser, footprint
from hw_sim.milky import MilkyGlass, gamma_means

DISTANCE_MM = 280.0
POSE, LEVEL, LASER = BeamPose(12.0, -7.0, 0.05, -0.1), BeamPose(0.0, 0.0), Laser()


def total(spots: list[Footprint], x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
    light: np.ndarray = sum(
        spot.irradiance(x_mm.astype(np.float32), y_mm.astype(np.float32)) for spot in spots
    )
    return light


def behind(glass: MilkyGlass, pose: BeamPose = LEVEL, laser: Laser = LASER) -> list[Footprint]:
    return glass.rear(footprint(laser, pose, DISTANCE_MM), pose, DISTANCE_MM)


def test_opal_glass_lights_the_rear_target_as_a_lambertian_point_does() -> None:
    """Within r of the point is the share r²/(D² + r²) of the light; the peak is P/(πD²), and 1.29 D wide."""
    spots = behind(MilkyGlass(1.0))
    r_mm = np.arange(0.25, 4000.0, 0.5)
    rings_mw = 2.0 * math.pi * r_mm * 0.5 * total(spots, r_mm, np.zeros_like(r_mm))
    for within_mm in (140.0, 280.0, 560.0):
        share = rings_mw[r_mm < within_mm].sum() / 3.0
        assert share == pytest.approx(within_mm**2 / (DISTANCE_MM**2 + within_mm**2), rel=0.03)
    light = total(spots, r_mm, np.zeros_like(r_mm))
    assert light[0] == pytest.approx(3.0 / (math.pi * DISTANCE_MM**2), rel=0.01)
    half_mm = DISTANCE_MM * math.sqrt(math.sqrt(2.0) - 1.0)
    assert r_mm[np.argmax(light < 0.5 * light[0])] == pytest.approx(half_mm, rel=0.03)


@pytest.mark.parametrize("half_angle_deg", [5.0, 15.0])
def test_ground_glass_convolves_the_beam_with_its_lobe(half_angle_deg: float) -> None:
    glass, laser = MilkyGlass(0.6, half_angle_deg), Laser(diameters_mm=(40.0, 10.0))
    axis_mm = np.arange(-256.0, 256.0)
    x_mm, y_mm = np.meshgrid(axis_mm, axis_mm)
    beam = footprint(laser, LEVEL, DISTANCE_MM).irradiance(x_mm.astype(np.float32), y_mm.astype(np.float32))
    n = math.log(0.5) / math.log(math.cos(math.radians(half_angle_deg)))
    cosine = DISTANCE_MM / np.sqrt(DISTANCE_MM**2 + x_mm**2 + y_mm**2)
    lobe = (n + 1.0) / (2.0 * math.pi * DISTANCE_MM**2) * cosine ** (n + 3.0)
    both = cv2.filter2D(beam.astype(np.float64), -1, lobe[128:385, 128:385], borderType=cv2.BORDER_CONSTANT)
    found = total(behind(glass, laser=laser), x_mm, y_mm)
    inner = slice(236, 277), slice(236, 277)
    assert found[inner] == pytest.approx((0.4 * beam + 0.6 * both)[inner], rel=0.02)


@pytest.mark.parametrize("half_angle_deg", [None, 5.0, 15.0])
def test_no_light_is_lost_behind_the_glass(half_angle_deg: float | None) -> None:
    power_mw = 0.0
    for spot in behind(MilkyGlass(0.7, half_angle_deg), POSE):
        xx, xy, yy = spot.form
        power_mw += spot.peak_mw_per_mm2 * math.pi / (2.0 * math.sqrt(xx * yy - xy * xy))
    assert power_mw == pytest.approx(3.0, rel=1e-6)


def test_only_opal_glass_loses_the_direction_of_the_beam() -> None:
    for glass, at in ((MilkyGlass(1.0, 5.0), POSE.at(DISTANCE_MM)), (MilkyGlass(1.0), POSE.at(0.0))):
        assert {(spot.x_mm, spot.y_mm) for spot in behind(glass, POSE)[1:]} == {at}


def test_lobes_are_the_means_of_a_gamma_distribution() -> None:
    """Of order 1 the quantiles are those of an exponential: the upper half has the mean 1 + ln 2."""
    assert gamma_means(1.0, 2) == pytest.approx([1.0 - math.log(2.0), 1.0 + math.log(2.0)], rel=1e-3)
    assert gamma_means(90.0, 16).mean() == pytest.approx(90.0, rel=1e-3)
