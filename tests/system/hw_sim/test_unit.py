"""Simulated units: their frame LEDs, and what differs by the seed or by one setting alone."""

import math

import cv2
import numpy as np
import pytest

from hw_sim.beam import BeamPose
from hw_sim.displacement import Displacement
from hw_sim.faults import Fault
from hw_sim.frame_leds import Shines, Stray
from hw_sim.motion import Drive, Vibration
from hw_sim.targets import LED_POSITIONS_MM, DotPattern
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


LEDS_MM = np.array(LED_POSITIONS_MM)


@pytest.fixture(scope="module")
def unit() -> Unit:
    made = Unit(UnitConfig(seed=3))
    made.inject(Fault.NO_LASER)
    return made


def mean_light(unit: Unit, leds_on: bool) -> np.ndarray:
    return unit.imagers["rear"].mean_e([], leds_on, 1.6).astype(np.float64)


def led_light(unit: Unit) -> np.ndarray:
    """The light that each LED adds to the picture, electrons."""
    light = mean_light(unit, True) - mean_light(unit, False)
    u, v = unit.imagers["rear"].view.lens.project(LEDS_MM[:, 0], LEDS_MM[:, 1])
    return np.array([window(light, a, b).sum() for a, b in zip(u, v, strict=True)])


def window(light: np.ndarray, u: float, v: float) -> np.ndarray:
    return light[max(round(v) - 16, 0) : round(v) + 17, max(round(u) - 16, 0) : round(u) + 17]


def centroid(light: np.ndarray, u: float, v: float) -> tuple[float, float]:
    top, left = max(round(v) - 16, 0), max(round(u) - 16, 0)
    part = window(light, u, v)
    rows, columns = np.mgrid[: part.shape[0], : part.shape[1]]
    return left + (part * columns).sum() / part.sum(), top + (part * rows).sum() / part.sum()


def test_each_led_can_be_dim_or_dark_alone(unit: Unit) -> None:
    usual = led_light(unit)
    unit.set_lights("rear", (1.0, 0.5, 0.0, 1.0, 1.0, 0.25))
    assert led_light(unit) / usual == pytest.approx([1.0, 0.5, 0.0, 1.0, 1.0, 0.25], abs=1e-3)
    unit.set_lights("rear")
    assert led_light(unit) == pytest.approx(usual)


def test_lights_that_are_no_leds_shine_when_they_should(unit: Unit) -> None:
    places = {Shines.WITH_LEDS: (20.0, -10.0), Shines.ALWAYS: (-30.0, 5.0)}
    unit.set_lights("rear", strays=())
    nothing = {on: mean_light(unit, on) for on in (False, True)}
    for when, (x, y) in places.items():
        unit.set_lights("rear", strays=(Stray(x, y, shines=when),))
        u, v = unit.imagers["rear"].view.lens.project(x, y)
        added = {on: (mean_light(unit, on) - nothing[on])[round(float(v)), round(float(u))] for on in nothing}
        assert added[True] > 1000
        assert bool(added[False] > 1000) is (when is Shines.ALWAYS)
    unit.set_lights("rear")


@pytest.mark.parametrize(
    "displacement",
    [Displacement((0.6, -0.4)), Displacement(turn_deg=0.5), Displacement(scale_ppm=3000.0)],
    ids=["shift", "turn", "scale"],
)
def test_a_displaced_camera_shows_the_leds_where_the_displacement_says(
    unit: Unit, displacement: Displacement
) -> None:
    lens = unit.imagers["rear"].view.lens
    unit.displace("rear", Displacement())
    before = mean_light(unit, True) - mean_light(unit, False)
    unit.displace("rear", displacement)
    after = mean_light(unit, True) - mean_light(unit, False)
    unit.displace("rear", Displacement())
    turn = math.radians(displacement.turn_deg)
    middle = np.array(lens.principal_px)
    for u, v in zip(*lens.project(LEDS_MM[:, 0], LEDS_MM[:, 1]), strict=True):
        seen = np.array(centroid(before, u, v))
        right, down = (1 + 1e-6 * displacement.scale_ppm) * (seen - middle)
        expected = (
            middle[0] + displacement.shift_px[0] + math.cos(turn) * right - math.sin(turn) * down,
            middle[1] + displacement.shift_px[1] + math.sin(turn) * right + math.cos(turn) * down,
        )
        assert centroid(after, *expected) == pytest.approx(expected, abs=0.05)


def test_the_spot_moves_with_the_picture_and_the_texture_with_the_target(unit: Unit) -> None:
    unit.clear()
    unit.place(BeamPose(10.0, 5.0))
    still = unit.expose("rear", 1, 0, exact=True).pixels.astype(float)
    unit.displace("rear", Displacement((4.0, 0.0)))
    moved = unit.expose("rear", 1, 0, exact=True).pixels.astype(float)
    unit.displace("rear", Displacement())
    unit.inject(Fault.NO_LASER)
    u, v = (round(float(part)) for part in unit.imagers["rear"].view.lens.project(10.0, 5.0))
    fine = [picture / cv2.GaussianBlur(picture, (0, 0), 2.0) - 1 for picture in (still, moved)]  # no spot
    here, there = fine[0][v - 12 : v + 13, u - 12 : u + 13], fine[1][v - 12 : v + 13, u - 8 : u + 17]
    unmoved = fine[1][v - 12 : v + 13, u - 12 : u + 13]
    assert np.corrcoef(here.ravel(), there.ravel())[0, 1] > 0.7
    assert abs(np.corrcoef(here.ravel(), unmoved.ravel())[0, 1]) < 0.3
