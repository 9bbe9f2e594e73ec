"""Limits of a calibration in the uncertainty of a beam; truth: a calibration that is wrong by them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from altd.instruments.beam.solver import Beam, fit_beam
from altd.records import Limits, TargetPoint

Z_MM = (0.0, 280.0)
X_MM, Y_MM, SX, SY = 60.0, -40.0, 0.09, -0.2
SCATTER_MM = 0.003

SCALE, SQUARE, TILT, DISTANCE_MM = 120e-6, 0.2e-3, 0.8e-3, 0.05
LIMITS = {
    "stage_scale_ppm": 120.0,
    "stage_square_mrad": 0.2,
    "beam_normal_mm_per_m": 0.8,
    "target_distance_mm": 0.05,
}


def beam_through(places_mm: list[tuple[float, float]], limits: Limits) -> Beam:
    points = [TargetPoint(x, y, np.eye(2), np.eye(2)) for x, y in places_mm]
    return fit_beam(Z_MM, points, SCATTER_MM**2 * np.eye(4), limits=limits)


def true_places() -> list[tuple[float, float]]:
    return [(X_MM + SX * z, Y_MM + SY * z) for z in Z_MM]


def mistaken(key: str) -> list[tuple[float, float]]:
    """The places that a map gives whose scan was wrong by one sigma of a limit, in x and y alike."""
    if key == "stage_scale_ppm":
        return [(x * (1 + SCALE), y * (1 + SCALE)) for x, y in true_places()]
    if key == "stage_square_mrad":
        return [(x + SQUARE * y, y + SQUARE * x) for x, y in true_places()]
    if key == "beam_normal_mm_per_m":
        return [(x + TILT * z, y + TILT * z) for (x, y), z in zip(true_places(), Z_MM, strict=True)]
    return [(X_MM + SX * z, Y_MM + SY * z) for z in (0.0, Z_MM[1] + DISTANCE_MM)]


def numbers(beam: Beam) -> list[float]:
    return [beam.x_mm, beam.y_mm, beam.yaw_deg, beam.pitch_deg]


def sigmas(beam: Beam) -> list[float]:
    return [beam.sigma_x_mm, beam.sigma_y_mm, beam.sigma_yaw_deg, beam.sigma_pitch_deg]


@pytest.mark.parametrize("key", LIMITS)
def test_each_limit_adds_the_error_that_it_makes(key: str) -> None:
    right = beam_through(true_places(), Limits(**{key: LIMITS[key]}))
    errors = np.subtract(numbers(beam_through(mistaken(key), Limits())), numbers(right))
    scatter = np.array(right.sigma_random)
    added = np.sqrt(np.square(sigmas(right)) - np.square(scatter))
    assert added == pytest.approx(np.abs(errors), rel=2e-3, abs=1e-9)


def test_limits_do_not_move_the_beam_and_leave_its_scattering_part() -> None:
    plain, limited = (beam_through(true_places(), limits) for limits in (Limits(), Limits(**LIMITS)))
    assert numbers(plain) == numbers(limited)
    assert sigmas(plain) == pytest.approx(list(limited.sigma_random or ()), rel=1e-12)
    per_slope_deg = math.degrees(1 / (1 + SX**2))
    assert plain.sigma_yaw_deg == pytest.approx(per_slope_deg * math.sqrt(2) * SCATTER_MM / 280.0)


def test_a_target_in_between_is_weighted_by_what_scatters_alone() -> None:
    """The limits are in the sums, not in the weights: a line through three right points stays it."""
    points = [TargetPoint(X_MM + SX * z, Y_MM + SY * z, np.eye(2), np.eye(2)) for z in (0.0, 140.0, 280.0)]
    beam = fit_beam((0.0, 140.0, 280.0), points, SCATTER_MM**2 * np.eye(6), limits=Limits(**LIMITS))
    assert beam.yaw_deg == pytest.approx(math.degrees(math.atan(SX)))
    assert beam.sigma_yaw_deg > math.degrees(TILT / (1 + SX**2))
