import math

import numpy as np
import pytest

from hw_sim.frame_leds import led_coverage
from hw_sim.targets import LED_POSITIONS_MM, DotPattern, DotPrint, speckle

PRINT = DotPrint(phase_mm=(0.3, 0.7), rotation_rad=0.02)


def cover_at(points: list[tuple[float, float]]) -> list[float]:
    x, y = np.array(points, dtype=np.float32).T
    return [float(value) for value in PRINT.cover(x, y, 0.001)]


def test_the_dots_cover_the_share_of_a_hexagonal_packing() -> None:
    axis = np.arange(-30.0, 30.0, 0.03, dtype=np.float32)
    covered = float(PRINT.cover(*np.meshgrid(axis, axis), 0.03).mean(dtype=np.float64))
    assert covered == pytest.approx(math.pi / (2.0 * math.sqrt(3.0)) * 0.5**2, rel=2e-3)


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
