"""The homography against OpenCV's, which shares no code with it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from altd.instruments.planar.homography import apply_homography, fit_homography, vanishing_line_homography

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
    assert apply_homography(fit_homography(corners, seen(corners)), NODES) == pytest.approx(
        seen(NODES), abs=1e-6
    )


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
