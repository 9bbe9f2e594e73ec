"""Estimates of a verification, against errors put in by formula."""

from __future__ import annotations

import math

import numpy as np
import pytest

from altd.calibration.verification.estimate import BeamSet, estimate, why_not_aligned, why_too_few

SIGMA = (0.01, 0.01, 0.003, 0.003)


def beams(
    places_mm: np.ndarray,
    *,
    turned: bool = False,
    scale_ppm: tuple[float, float] = (0.0, 0.0),
    square_mrad: float = 0.0,
    rotation_mrad: float = 0.0,
    offset_mm: tuple[float, float] = (0.0, 0.0),
    zero_deg: tuple[float, float] = (0.0, 0.0),
    beam_deg: tuple[float, float] = (0.0, 0.0),
    scatter: float = 0.0,
    seed: int = 0,
) -> BeamSet:
    """The readings of a unit with these errors; ``scatter`` is in stated sigmas."""
    rng = np.random.default_rng(seed)
    sign = -1.0 if turned else 1.0
    angle = 1e-3 * rotation_mrad
    mount = sign * np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    half = 1e-3 * square_mrad / 2
    reads = np.array([[1 + 1e-6 * scale_ppm[0], half], [half, 1 + 1e-6 * scale_ppm[1]]])
    xy = places_mm @ mount.T @ reads.T + offset_mm
    angles = np.array(zero_deg) + sign * np.array(beam_deg) + np.zeros_like(xy)
    values = np.hstack([xy, angles]) + scatter * rng.normal(0, SIGMA, (len(xy), 4))
    sigma = np.tile(SIGMA, (len(xy), 1))
    return BeamSet(places_mm, values, sigma, np.zeros((len(xy), 4, 1)), turned, 0.0)


def grid(pitch_mm: float = 30.0, columns: int = 5, rows: int = 4) -> np.ndarray:
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    return pitch_mm * np.column_stack([x.ravel() - (columns - 1) / 2, y.ravel() - (rows - 1) / 2])


def test_errors_and_mounting_are_told_apart_exactly() -> None:
    wrong = {"scale_ppm": (300.0, -200.0), "square_mrad": 0.4, "zero_deg": (0.02, -0.03)}
    upright = beams(grid(), rotation_mrad=50.0, offset_mm=(1.0, 2.0), beam_deg=(0.1, 0.2), **wrong)
    turned = beams(
        grid(), turned=True, rotation_mrad=-20.0, offset_mm=(3.0, -4.0), beam_deg=(0.1, 0.2), **wrong
    )
    found = estimate([upright, turned])
    # a scale of s and a mount of r rad leave s r² / 2, below 1 ppm here
    assert [one.value for one in found.scale_ppm] == pytest.approx([300.0, -200.0], abs=1.0)
    assert found.square_mrad.value == pytest.approx(0.4, abs=0.002)
    assert found.zero_deg is not None
    assert [one.value for one in found.zero_deg] == pytest.approx([0.02, -0.03], abs=1e-9)
    assert found.rotations_mrad == pytest.approx([50.0, -20.0], abs=0.05)
    assert found.offsets_mm == pytest.approx(np.array([[1.0, 2.0], [3.0, -4.0]]), abs=1e-3)
    assert found.directions_deg == pytest.approx(np.array([[0.12, 0.17], [-0.08, -0.23]]), abs=1e-9)
    assert found.displacement.experimental < 1e-4
    assert found.direction.experimental < 1e-9


def test_one_orientation_shows_no_zero_without_the_beam() -> None:
    found = estimate([beams(grid(), zero_deg=(0.02, 0.0), beam_deg=(0.1, 0.0))])
    assert found.zero_deg is None
    assert found.upright_deg is not None
    assert found.upright_deg[0].value == pytest.approx(0.12)


def test_uncertainties_are_those_of_least_squares_where_places_are_far_apart() -> None:
    places = grid()
    found = estimate([beams(places)])
    # independent errors of 10 µm: sigma of a slope is sigma / root of the sum of squares
    per_x, per_y = (0.01 / math.sqrt(np.square(axis).sum()) for axis in places.T)
    assert found.scale_ppm[0].sigma == pytest.approx(1e6 * per_x, rel=1e-6)
    assert found.scale_ppm[1].sigma == pytest.approx(1e6 * per_y, rel=1e-6)
    # dx/dy and dy/dx are independent slopes, squareness is their sum
    assert found.square_mrad.sigma == pytest.approx(1e3 * math.hypot(per_x, per_y), rel=1e-6)
    assert found.displacement.degrees_of_freedom == pytest.approx(2 * len(places) - 6, rel=1e-3)
    assert found.direction.degrees_of_freedom == pytest.approx(2 * len(places) - 2, rel=1e-3)


def test_places_that_are_measured_again_are_no_new_evidence() -> None:
    one = estimate([beams(grid())])
    twice = estimate([beams(grid()), beams(grid())])
    assert twice.scale_ppm[0].sigma == pytest.approx(one.scale_ppm[0].sigma, rel=1e-3)
    assert twice.direction.degrees_of_freedom == pytest.approx(one.direction.degrees_of_freedom, rel=0.03)


def test_an_error_that_the_map_has_everywhere_is_not_averaged_away() -> None:
    upright = beams(grid())
    common = np.zeros((len(upright), 4, 1))
    common[:, 2, 0] = 0.002
    shared = BeamSet(upright.known_mm, upright.values, upright.sigma, common, False, 0.0)
    found = estimate([shared])
    assert found.upright_deg is not None
    own = (0.003**2 - 0.002**2) / len(upright)
    assert found.upright_deg[0].sigma == pytest.approx(math.sqrt(0.002**2 + own), rel=1e-3)


def test_the_experimental_standard_deviation_is_that_of_the_scatter() -> None:
    found = estimate([beams(grid(10.0, 12, 10), scatter=2.0, seed=3)])
    for scatter, stated in ((found.displacement, 0.01), (found.direction, 0.003)):
        assert scatter.stated == pytest.approx(stated)
        spread = 1 / math.sqrt(2 * scatter.degrees_of_freedom)
        assert scatter.experimental / (2 * stated) == pytest.approx(1.0, abs=4 * spread)


@pytest.mark.parametrize(
    ("places", "why"),
    [
        (grid(columns=2, rows=2), "too few positions: 4 valid, at least 5 are needed"),
        (grid(columns=9, rows=1), "its positions are on one line"),
        (np.zeros((9, 2)), "its positions are on one line"),
        (grid(), ""),
    ],
)
def test_a_set_that_cannot_show_anything_says_why(places: np.ndarray, why: str) -> None:
    assert why_too_few(beams(places)) == why


def test_a_set_of_the_wrong_orientation_is_noticed() -> None:
    right = beams(grid(), turned=True)
    assert why_not_aligned(right) == ""
    wrong = BeamSet(right.known_mm, right.values, right.sigma, right.map_factor, False, 0.0)
    assert "turned by 180°" in why_not_aligned(wrong).replace("-", "")
