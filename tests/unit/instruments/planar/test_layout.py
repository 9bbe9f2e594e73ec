"""LEDs of a plate in pictures by formula; which lights are LEDs; the homography against OpenCV's."""

import cv2
import numpy as np
import pytest

from altd.instruments.planar.homography import (
    apply_homography,
    fit_homography,
    fit_rims,
    vanishing_line_homography,
)
from altd.instruments.planar.layout import (
    check_layout,
    placed_mm,
    projective_match,
    rigid_matches,
    rigid_pose,
    wrapped_deg,
)
from altd.instruments.planar.leds import find_leds, led_image, rim_points_px

LEDS = np.array([(-41, -40), (-7, -39), (31, -32), (44, 16), (11, 3), (-38, 23), (2, 39)], dtype=float)
TILTED = np.array([[2.6, 0.2, 400.0], [0.1, -2.5, 380.0], [4e-4, -6e-4, 1.0]])
"""A camera that is tilted by some 25°; v runs down."""


def pictured(points: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.perspectiveTransform(points[None], TILTED)[0])


def tolerances(count: int) -> np.ndarray:
    return np.full(count, 0.05)


@pytest.mark.parametrize(
    ("angle", "wrapped"), [(180.0, 180.0), (-180.0, 180.0), (540.0, 180.0), (-179.5, -179.5), (361.0, 1.0)]
)
def test_turns_are_above_minus_180_and_up_to_180(angle: float, wrapped: float) -> None:
    assert wrapped_deg(angle) == pytest.approx(wrapped)


@pytest.mark.parametrize("pose", [(3.0, 700.0, 12.0), (-20.0, 5.0, 180.0), (0.0, 0.0, -91.0)])
def test_a_rigid_pose_is_that_of_equation_2_59(pose: tuple[float, float, float]) -> None:
    a, b, phi = pose
    turn = cv2.getRotationMatrix2D((0.0, 0.0), -phi, 1.0)[:, :2]  # OpenCV's turns are clockwise with y up
    at = LEDS @ turn.T + (a, b)
    assert placed_mm(LEDS, pose) == pytest.approx(at)
    assert rigid_pose(LEDS, at) == pytest.approx(pose)


@pytest.mark.parametrize("lit", [[0, 1, 2, 3, 4, 5, 6], [6, 2, 0], [3, 5]])
def test_lights_are_leds_whichever_are_dark_and_wherever_the_plate_is(lit: list[int]) -> None:
    pose = (12.0, 690.0, 155.0)
    best = rigid_matches(LEDS, placed_mm(LEDS, pose)[lit], tolerances(len(lit)))[0]
    ways = rigid_matches(LEDS, placed_mm(LEDS, pose)[lit], tolerances(len(lit)))
    if len(lit) > 2:
        assert best.pose == pytest.approx(pose)
        assert [lit[light] for _, light in best.pairs] == [led for led, _ in best.pairs]
    else:  # two LEDs look the same when the plate is turned
        assert sorted(round(way.pose[2]) for way in ways) == [-25, 155]


def test_three_leds_and_a_light_that_is_none_give_the_three() -> None:
    lights = np.vstack([placed_mm(LEDS, (0.0, 0.0, 30.0))[[1, 3, 6]], (70.0, -60.0)])
    best, *others = rigid_matches(LEDS, lights, tolerances(4))
    assert best.pairs == ((1, 0), (3, 1), (6, 2))
    assert all(len(way.pairs) == 2 for way in others)


@pytest.mark.parametrize(
    ("leds", "said"),
    [
        ([(-10, 0), (10, 0), (0, 5), (0, -5)], "turned by 180°"),
        ([(0, 0), (10, 0), (10, 10), (0, 10)], "turned by"),
        ([(0, 0), (10, 0), (30, 0), (60, 0)], "lie on a line"),
    ],
)
def test_a_layout_that_leaves_the_pose_open_is_refused(leds: list[tuple[int, int]], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        check_layout(np.array(leds, dtype=float))


def test_a_layout_without_symmetry_is_accepted() -> None:
    check_layout(LEDS)


def test_the_layout_alone_tells_the_leds_in_a_tilted_picture() -> None:
    order = [4, 2, 6, 0, 1, 5]  # LED 3 is dark
    lights = np.vstack([pictured(placed_mm(LEDS, (5.0, -8.0, 70.0)))[order], (900.0, 40.0)])
    assert projective_match(LEDS, lights) == tuple(sorted((led, at) for at, led in enumerate(order)))


def test_a_mirrored_picture_of_the_layout_is_none() -> None:
    with pytest.raises(ValueError, match="no 6 fit the layout"):
        projective_match(LEDS, pictured(LEDS * (-1.0, 1.0)))


def test_lights_at_random_are_no_layout() -> None:
    lights = np.random.default_rng(3).uniform(0, 1000, size=(7, 2))
    with pytest.raises(ValueError, match="7 lights are seen"):
        projective_match(LEDS, lights)


TRUTH = np.array([[4.1, 0.2, 370.0], [-0.15, -3.9, 241.0], [4e-4, -7e-4, 1.0]])

x, y = np.meshgrid((np.arange(7) - 3) * 25.0, (np.arange(5) - 2) * 25.0)
NODES = np.column_stack([x.ravel(), y.ravel()])


def seen(points: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.perspectiveTransform(points[None], TRUTH)[0])


def test_exact_points_give_the_homography_by_the_vanishing_line_alone_and_refined() -> None:
    direct = vanishing_line_homography(NODES, seen(NODES))
    assert direct / direct[2, 2] == pytest.approx(TRUTH, rel=1e-6, abs=1e-9)
    assert fit_homography(NODES, seen(NODES)) == pytest.approx(TRUTH, rel=1e-9, abs=1e-12)


def test_four_points_are_enough() -> None:
    corners = NODES[[0, 6, 28, 34]]
    fitted = fit_homography(corners, seen(corners))
    assert apply_homography(fitted, NODES) == pytest.approx(seen(NODES), abs=1e-6)


def test_the_vanishing_line_is_what_is_mapped_to_infinity() -> None:
    """Eq. 2.53: points with h7 x + h8 y + h9 = 0."""
    line = vanishing_line_homography(NODES, seen(NODES))[2]
    truth = TRUTH[2] / np.linalg.norm(TRUTH[2])
    assert line * np.sign(line[2]) == pytest.approx(truth, abs=1e-9)


@pytest.mark.parametrize("noise", [0.05, 1.0])
def test_noisy_points_give_the_least_squares_of_opencv(noise: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        px = seen(NODES) + rng.normal(0, noise, NODES.shape)
        theirs = cv2.findHomography(NODES, px, 0)[0]
        ours = fit_homography(NODES, px)
        assert apply_homography(ours, NODES) == pytest.approx(apply_homography(theirs, NODES), abs=1e-3)
        squares = [np.square(apply_homography(h, NODES) - px).sum() for h in (ours, theirs)]
        assert squares[0] <= squares[1] * (1 + 1e-9)


def test_refining_takes_the_algebraic_bias_away() -> None:
    rng = np.random.default_rng(2)
    px = seen(NODES) + rng.normal(0, 2.0, NODES.shape)
    direct, refined = vanishing_line_homography(NODES, px), fit_homography(NODES, px)
    squares = [np.square(apply_homography(h, NODES) - px).sum() for h in (refined, direct)]
    assert squares[0] < squares[1]


def test_points_that_leave_it_undetermined_are_refused() -> None:
    with pytest.raises(ValueError, match="3 points are too few"):
        fit_homography(NODES[:3], seen(NODES[:3]))
    with pytest.raises(ValueError, match="on a line"):
        fit_homography(NODES[:7], seen(NODES[:7]))
    three_on_a_line = NODES[[0, 1, 2, 30]]
    with pytest.raises(ValueError, match="undetermined"):
        fit_homography(three_on_a_line, seen(three_on_a_line))


def test_rims_of_circles_give_the_homography_whatever_their_radius() -> None:
    # of a circle the middle is not seen in the middle: its rim tells
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    circle = 3.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rims = [seen(node + circle) for node in NODES]
    middles = np.array([rim.mean(axis=0) for rim in rims])
    back = np.linalg.inv(TRUTH)
    by_middles = fit_homography(middles, NODES)
    assert np.abs(apply_homography(by_middles, seen(NODES)) - NODES).max() > 1e-3
    refined = fit_rims(by_middles, rims, NODES, 2.7)
    assert refined == pytest.approx(back / back[2, 2], rel=1e-6, abs=1e-9)


LEVEL = 150.0


def picture(places: list[tuple[float, float]], radius_px: float) -> np.ndarray:
    """Discs with half their light at the radius, on a background that slopes."""
    v, u = np.mgrid[:120, :160]
    counts = 10.0 + 0.05 * u + 0.02 * v
    for at_u, at_v in places:
        counts += LEVEL / (1.0 + np.exp((np.hypot(u - at_u, v - at_v) - radius_px) / 0.5))
    return counts.astype(np.float32)


@pytest.mark.parametrize("radius_px", [6.0, 9.13])
def test_a_rim_is_where_half_the_light_of_a_disc_is(radius_px: float) -> None:
    place = 60.3, 51.8
    image = led_image(picture([place], radius_px))
    (disc,) = find_leds(image)
    assert (disc.u_px, disc.v_px) == pytest.approx(place, abs=0.02)
    distance_px = np.hypot(*(rim_points_px(image, disc) - place).T)
    assert len(distance_px) == 32
    assert distance_px.mean() == pytest.approx(radius_px, abs=0.05)
    assert distance_px.std() < 0.1


def test_a_disc_that_the_border_cuts_is_no_led() -> None:
    found = find_leds(led_image(picture([(60.0, 50.0), (2.0, 90.0), (110.0, 30.0)], 7.0)))
    assert sorted(round(disc.u_px) for disc in found) == [60, 110]
