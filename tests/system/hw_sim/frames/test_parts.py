"""Parts of a simulated unit against formulas and OpenCV: beam, lens, sensor, print, LEDs and speckle."""

import math
from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from hw_sim.assembly import FRONT_FOCAL_MM, REAR_FOCAL_MM, make_lens
from hw_sim.beam import BeamPose, Footprint, Laser, footprint
from hw_sim.frame_leds import led_coverage
from hw_sim.lens import HEIGHT_PX, WIDTH_PX, Lens
from hw_sim.sensor import FULL_WELL_E, READ_NOISE_E, NoisePool, Sensor
from hw_sim.targets import LED_POSITIONS_MM, DotPattern, DotPrint, speckle

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


Projection = Callable[[Lens, npt.ArrayLike], npt.NDArray[np.float64]]

LED_GRID_MM = np.stack(np.meshgrid(np.arange(-75.0, 76.0, 25.0), np.arange(-50.0, 51.0, 25.0)), -1).reshape(
    -1, 2
)
"""The 7 × 5 LEDs, 25 mm apart, of Sec. 3.3.2."""


def lenses(seed: int) -> tuple[Lens, Lens]:
    """A front and a rear lens."""
    rng = np.random.default_rng(seed)
    return make_lens(FRONT_FOCAL_MM, True, rng), make_lens(REAR_FOCAL_MM, False, rng)


@pytest.mark.parametrize("seed", range(5))
def test_points_land_where_opencv_puts_them(seed: int, opencv_project: Projection) -> None:
    for lens in lenses(seed):
        u, v = lens.project(*LED_GRID_MM.T)
        assert np.abs(np.column_stack([u, v]) - opencv_project(lens, LED_GRID_MM)).max() < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_a_pixel_shows_the_point_that_lands_on_it(seed: int) -> None:
    corners = np.array(
        [[0, 0], [WIDTH_PX - 1, 0], [0, HEIGHT_PX - 1], [WIDTH_PX - 1, HEIGHT_PX - 1], [300, 7]]
    )
    for lens in lenses(seed):
        u, v = lens.project(*lens.unproject(*corners.T))
        assert np.abs(np.column_stack([u, v]) - corners).max() < 1e-7


@pytest.mark.parametrize("seed", range(5))
def test_the_largest_spot_at_the_edge_of_the_area_fills_the_picture(seed: int) -> None:
    """140 × 110 mm and half of 15 mm around (App. A.1)."""
    for lens in lenses(seed):
        u, v = lens.project([-77.5, 77.5, 77.5, -77.5, 0.0, 0.0], [-62.5, -62.5, 62.5, 62.5, 62.5, -62.5])
        assert 0.0 < u.min() < u.max() < WIDTH_PX
        assert 0.0 < v.min() < v.max() < HEIGHT_PX
        assert v.max() - v.min() > 0.92 * HEIGHT_PX


@pytest.mark.parametrize("seed", range(5))
def test_the_lens_for_the_rear_target_stands_about_where_the_thesis_had_it(seed: int) -> None:
    """Sec. 3.3.2: f = 5.7 mm at 250 mm, square to the plate; one that looks past the beam is farther off."""
    rear = lenses(seed)[1]
    assert 250.0 < rear.translation_mm[2] * 5.7 / rear.focal_mm < 250.0 / np.cos(np.radians(23.0))


def test_a_homography_alone_misses_by_what_the_thesis_found() -> None:
    """Table 3.2: 0.1921 mm mean at f = 8 and 0.4130 mm at 5.7, of two particular lenses."""
    for which, published_mm in enumerate((0.1921, 0.4130)):
        means_mm = []
        for seed in range(8):
            lens = lenses(seed)[which]
            pixels = np.column_stack(lens.project(*LED_GRID_MM.T))
            back, _ = cv2.findHomography(pixels, LED_GRID_MM)
            mapped = cv2.perspectiveTransform(pixels.reshape(-1, 1, 2), back).reshape(-1, 2)
            means_mm.append(np.linalg.norm(mapped - LED_GRID_MM, axis=1).mean())
        assert 0.5 * published_mm < np.mean(means_mm) < 2.0 * published_mm


def test_light_falls_off_with_the_fourth_power_of_the_cosine() -> None:
    straight = Lens(6.0, (375.5, 239.5), (0, 0, 0, 0, 0), np.eye(3), np.array([0.0, 0.0, 250.0]), False)
    assert straight.relative_illumination(250.0, 0.0) == pytest.approx(np.cos(np.pi / 4) ** 4)


def uniform(electrons: float) -> np.ndarray:
    return np.full((200, 250), electrons, dtype=np.float32)


@pytest.mark.parametrize("electrons", [0.0, 300.0, 3_000.0, 12_000.0])
def test_the_variance_is_that_of_photons_and_read_out(electrons: float) -> None:
    """The photon transfer curve: variance in electrons = mean + read noise²."""
    pixels = Sensor(bits=16).expose(uniform(electrons), 1.0, np.random.default_rng(2)).astype(np.float64)
    counts_per_e = 65_535 / FULL_WELL_E
    variance_e = pixels.var() / counts_per_e**2
    assert variance_e == pytest.approx(electrons + READ_NOISE_E**2, rel=4.0 * math.sqrt(2.0 / pixels.size))


def test_stretches_of_the_pool_are_repeatable_and_do_not_resemble_each_other() -> None:
    pool = NoisePool(np.random.default_rng(5))
    first = pool.stretch(1, (480, 752))
    assert np.array_equal(first, pool.stretch(1, (480, 752)))
    for key in range(2, 12):
        assert abs(float(np.corrcoef(first.ravel(), pool.stretch(key, (480, 752)).ravel())[0, 1])) < 0.01


@pytest.mark.parametrize(
    ("bits", "dtype"), [(8, np.uint8), (10, np.uint16), (12, np.uint16), (16, np.uint16)]
)
def test_a_full_well_reads_full_scale_and_never_wraps(bits: int, dtype: type) -> None:
    pixels = Sensor(bits).expose(uniform(10.0 * FULL_WELL_E), 4.0, np.random.default_rng(6))
    assert pixels.dtype == dtype
    assert set(np.unique(pixels)) == {2**bits - 1}


PRINT = DotPrint(phase_mm=(0.3, 0.7), rotation_rad=0.02)


def cover_at(points: list[tuple[float, float]]) -> list[float]:
    x, y = np.array(points, dtype=np.float32).T
    return [float(value) for value in PRINT.cover(x, y, 0.001)]


def test_a_dot_has_six_neighbours_a_pitch_away_and_clear_glass_between() -> None:
    x0, y0 = PRINT.phase_mm
    ring = [k * math.pi / 3.0 + PRINT.rotation_rad for k in range(6)]
    assert cover_at([(x0 + math.cos(a), y0 + math.sin(a)) for a in ring]) == [1.0] * 6
    assert cover_at([(x0 + 0.5 * math.cos(a), y0 + 0.5 * math.sin(a)) for a in ring]) == [0.0] * 6


def test_a_dot_ends_at_its_radius() -> None:
    x0, y0 = PRINT.phase_mm
    assert cover_at([(x0, y0), (x0, y0 + 0.24), (x0, y0 + 0.26)]) == [1.0, 1.0, 0.0]


def test_the_dots_of_an_orthogonal_print_cover_a_quarter_circle_of_each_square() -> None:
    dots = DotPrint((0.3, 0.7), 0.02, DotPattern(diameter_mm=1.0, pitch_mm=2.0, hexagonal=False))
    axis = np.arange(-30.0, 30.0, 0.03, dtype=np.float32)
    covered = float(dots.cover(*np.meshgrid(axis, axis), 0.03).mean(dtype=np.float64))
    assert covered == pytest.approx(math.pi * 0.25 / 4.0, rel=2e-3)
    assert dots.pattern.coverage == pytest.approx(math.pi * 0.25 / 4.0)


def test_a_dot_of_an_orthogonal_print_has_four_neighbours() -> None:
    dots = DotPrint((0.3, 0.7), 0.0, DotPattern(diameter_mm=1.0, pitch_mm=2.0, hexagonal=False))
    at = [(2.3, 0.7), (0.3, -1.3), (-1.7, 0.7), (0.3, 2.7), (1.3, 1.7), (1.3, 0.7)]
    x, y = np.array(at, dtype=np.float32).T
    assert dots.cover(x, y, 0.001).tolist() == [1.0] * 4 + [0.0] * 2


def test_the_frame_leds_lie_outside_of_the_scanned_area() -> None:
    scanned = np.meshgrid(np.linspace(-70.0, 70.0, 200), np.linspace(-55.0, 55.0, 200))
    x, y = (axis.astype(np.float32) for axis in scanned)
    assert led_coverage(x, y, 0.01).max() == 0.0
    at_x, at_y = np.array(LED_POSITIONS_MM, dtype=np.float32).T
    assert led_coverage(at_x, at_y, 0.01).tolist() == [1.0] * 6


def test_speckle_has_its_contrast_from_pixel_to_pixel() -> None:
    factor = speckle(np.random.default_rng(1), (480, 752), 0.12).astype(np.float64)
    rest = factor - 1.0
    assert abs(rest.mean()) < 1e-4
    assert rest.std() == pytest.approx(0.12, rel=0.01)
    assert abs((rest[:, :-1] * rest[:, 1:]).mean() / rest.var()) < 0.01
