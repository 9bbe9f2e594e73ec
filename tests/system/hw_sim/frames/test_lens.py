from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from hw_sim.assembly import FRONT_FOCAL_MM, REAR_FOCAL_MM, make_lens
from hw_sim.lens import HEIGHT_PX, WIDTH_PX, Lens

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


def test_the_front_picture_is_mirrored_and_the_rear_is_not() -> None:
    for lens, sign in zip(lenses(0), (-1.0, 1.0), strict=True):
        (u0, u_right, u_up), (v0, _, v_up) = lens.project([0.0, 10.0, 0.0], [0.0, 0.0, 10.0])
        assert sign * (u_right - u0) > 30.0
        assert v0 - v_up > 30.0
        assert abs(u_up - u0) < 2.0


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
