"""The direct fit of an ellipse against formulas and against OpenCV's own direct fit."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from altd.vision.ellipse import fit_conic

SHAPES = [(1.0, 1.0, 0.0), (1.2, 0.7, 0.4), (1.3, 0.5, 2.5), (0.6, 1.6, 1.0)]


def points(
    first: float, second: float, angle: float, centre: tuple[float, float], count: int = 90
) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 2) of an ellipse, unevenly spaced, and the outer normals there."""
    around = np.linspace(0, 2 * np.pi, count, endpoint=False)
    around += 0.2 * np.sin(2 * around)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    on = np.stack([first * np.cos(around), second * np.sin(around)], axis=1)
    normals = np.stack([np.cos(around) / first, np.sin(around) / second], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return on @ turn.T + centre, normals @ turn.T


@pytest.mark.parametrize(("first", "second", "angle"), SHAPES)
def test_the_centre_of_an_exact_ellipse_is_exact(first: float, second: float, angle: float) -> None:
    for centre in ((0.0, 0.0), (0.05, -0.08)):
        on, _ = points(first, second, angle, centre)
        fitted = fit_conic(*on.T)
        assert fitted is not None
        assert (fitted.x, fitted.y) == pytest.approx(centre, abs=1e-10)


@pytest.mark.parametrize(("first", "second", "angle"), SHAPES)
def test_noisy_points_give_the_centre_that_opencv_finds(first: float, second: float, angle: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        on, _ = points(first, second, angle, (0.02, 0.03))
        on += rng.normal(0, 0.02, on.shape)
        on -= on.mean(axis=0)
        fitted = fit_conic(*on.T)
        assert fitted is not None
        (x, y), _, _ = cv2.fitEllipseDirect((100 * on).astype(np.float32))
        assert (100 * fitted.x, 100 * fitted.y) == pytest.approx((x, y), abs=0.01)


@pytest.mark.parametrize(("first", "second", "angle"), SHAPES)
def test_sensitivities_say_how_a_displaced_point_moves_the_centre(
    first: float, second: float, angle: float
) -> None:
    on, normals = points(first, second, angle, (0.02, -0.03))
    fitted = fit_conic(*on.T)
    assert fitted is not None
    step = 1e-5
    for index in range(0, len(on), 7):
        moved = on.copy()
        moved[index] += step * normals[index]
        again = fit_conic(*moved.T)
        assert again is not None
        shift = (again.x - fitted.x, again.y - fitted.y)
        assert fitted.sensitivities[:, index] * step == pytest.approx(shift, abs=2e-3 * step / 10)


@pytest.mark.parametrize(("first", "second", "angle"), SHAPES)
def test_sensitivities_predict_what_noise_does(first: float, second: float, angle: float) -> None:
    rng = np.random.default_rng(2)
    on, normals = points(first, second, angle, (0.0, 0.0))
    exact = fit_conic(*on.T)
    assert exact is not None
    noise = 0.01
    centres = []
    for _ in range(600):
        fitted = fit_conic(*(on + noise * rng.standard_normal(len(on))[:, None] * normals).T)
        assert fitted is not None
        centres.append((fitted.x, fitted.y))
    expected = noise * np.sqrt(np.square(exact.sensitivities).sum(axis=1))
    assert np.sqrt(np.mean(np.square(centres), axis=0)) / expected == pytest.approx(1.0, abs=0.1)


def test_points_on_a_line_are_no_ellipse() -> None:
    along = np.linspace(-1, 1, 20)
    assert fit_conic(along, np.zeros(20)) is None
