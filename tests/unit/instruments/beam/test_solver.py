"""The beam through two points, and limits of a calibration in its uncertainty."""

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.evidence import calibration

from altd.config import Expansion, Installation, Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.instruments.beam.solver import KEYS, Beam, fit_beam, joint_covariance_mm2
from altd.instruments.beam.systematics import Warmth
from altd.measuring.instrument import Solution
from altd.records import Limits, MeanSpots, TargetPoint


def point(x: float, y: float, sigma: float = 0.01, scale: float = 0.25) -> TargetPoint:
    return TargetPoint(x, y, scale * np.eye(2), sigma**2 * np.eye(2))


def test_two_points_give_the_beam_of_the_conventions() -> None:
    beam = fit_beam([0.0, 280.0], [point(10, 5), point(15.6, -3.4)], 1e-4 * np.eye(4))
    assert (beam.x_mm, beam.y_mm) == pytest.approx((10, 5))
    assert beam.yaw_deg == pytest.approx(math.degrees(math.atan(5.6 / 280)))
    assert beam.pitch_deg == pytest.approx(math.degrees(math.atan(-8.4 / 280)))
    assert (beam.yaw_mm_per_m, beam.pitch_mm_per_m) == pytest.approx((20, -30))


def test_the_displacement_is_that_at_the_reference_plane() -> None:
    beam = fit_beam([0.0, 280.0], [point(10, 5), point(38, -23)], 1e-4 * np.eye(4), -1000.0)
    assert (beam.x_mm, beam.y_mm) == pytest.approx((-90, 105))


def test_a_tenth_of_a_millimetre_is_0_0289_degrees_as_the_thesis_says() -> None:
    """Fig. 3.5: 0.1 mm on both targets 280 mm apart; closed form √2 · 0.1 / 280 rad."""
    beam = fit_beam([0.0, 280.0], [point(0, 0), point(0, 0)], 0.01 * np.eye(4))
    assert beam.sigma_yaw_deg == pytest.approx(math.degrees(math.sqrt(2) * 0.1 / 280), rel=1e-9)
    assert beam.sigma_yaw_deg == pytest.approx(0.0289, abs=5e-5)
    assert beam.sigma_x_mm == pytest.approx(0.1)


def test_sigmas_agree_with_monte_carlo_for_correlated_points() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(0, 0.01, (4, 4))
    covariance = root @ root.T
    truth = np.array([10.0, 5.0, -20.0, 40.0])
    draws = rng.multivariate_normal(truth, covariance, 4000)
    beams = [fit_beam([0.0, 280.0], [point(*d[:2]), point(*d[2:])], covariance, 100.0) for d in draws]
    one = beams[0]
    for name in ("x_mm", "y_mm", "yaw_deg", "pitch_deg"):
        scatter = np.std([getattr(beam, name) for beam in beams])
        assert getattr(one, f"sigma_{name}") == pytest.approx(scatter, rel=0.05)


def test_three_targets_are_fitted_by_least_squares() -> None:
    points = [point(0, 0), point(1.0, 2.0), point(2.3, 4.0)]
    beam = fit_beam([0.0, 100.0, 200.0], points, 1e-4 * np.eye(6))
    slope, offset = np.polyfit([0, 100, 200], [0, 1.0, 2.3], 1)
    assert beam.x_mm == pytest.approx(offset)
    assert beam.yaw_mm_per_m == pytest.approx(1000 * slope)


def test_scatter_goes_through_the_jacobians_and_the_maps_add_their_own() -> None:
    shared = np.kron(np.ones((2, 2)), 0.04 * np.eye(2))
    spots = MeanSpots(("front", "rear"), np.zeros((2, 2)), shared, 0, 20, 0)
    covariance = joint_covariance_mm2(spots, [point(0, 0, 0.01, 0.25), point(0, 0, 0.02, -0.25)])
    assert np.diag(covariance) == pytest.approx([0.0026, 0.0026, 0.0029, 0.0029])
    assert covariance[0, 2] == pytest.approx(-0.0025)


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


def _seen(x: float, y: float, turn: tuple[float, float, float], away_mm: float) -> tuple[float, float]:
    """The place of the target where a camera sees the point of a plate turned about its middle."""
    point, camera = cv2.Rodrigues(np.array(turn))[0] @ (x, y, 0.0), np.array([0.0, 0.0, -away_mm])
    ray = point - camera
    place = camera + ray * away_mm / ray[2]
    return float(place[0]), float(place[1])


@pytest.mark.parametrize(
    ("limits", "axes"),
    [(Limits(plate_turn_mrad=0.1), (2,)), (Limits(plate_keystone_per_m=0.1 / 300), (0, 1))],
)
def test_a_plate_askew_on_each_target_adds_what_its_camera_sees(
    limits: Limits, axes: tuple[int, ...]
) -> None:
    """0.1 mrad, about one axis of one target at a time, before a camera 300 mm away."""
    right = beam_through(true_places(), limits)
    errors = []
    for target in range(2):
        for axis in axes:
            places = true_places()
            turn = [0.0, 0.0, 0.0]
            turn[axis] = 1e-4
            places[target] = _seen(*places[target], (turn[0], turn[1], turn[2]), 300.0)
            errors.append(np.subtract(numbers(beam_through(places, Limits())), numbers(right)))
    added = np.sqrt(np.square(sigmas(right)) - np.square(right.sigma_random or ()))
    assert added == pytest.approx(np.linalg.norm(errors, axis=0), rel=2e-3)


def test_a_warmer_frame_adds_its_smaller_pictures_and_its_longer_distance() -> None:
    """Aluminium, 23.6 ppm/K: pictures shrink about the zero, and the rear target is farther away."""
    longer = 1 + 40 * 23.6e-6
    right = beam_through(true_places(), Limits(temperature_k=40.0))
    shrunk = beam_through([(x / longer, y / longer) for x, y in true_places()], Limits())
    farther = beam_through([(X_MM + SX * z, Y_MM + SY * z) for z in (0.0, Z_MM[1] * longer)], Limits())
    errors = np.hypot(*(np.subtract(numbers(wrong), numbers(right)) for wrong in (shrunk, farther)))
    added = np.sqrt(np.square(sigmas(right)) - np.square(right.sigma_random or ()))
    assert added == pytest.approx(errors, rel=2e-3, abs=1e-9)


def solved(places_mm: Sequence[Sequence[float]], now_c: float | None, **changes: object) -> Solution:
    """Solution of a unit, calibrated at 21 °C and stated to 5 K, whose cold maps see the spots there."""
    limits = Limits(temperature_k=5.0)
    made = replace(calibration(), limits=limits, temperature_c=21.0)
    px = [of.map.to_px(np.array([place]))[0] for of, place in zip(made.targets, places_mm, strict=True)]
    spots = MeanSpots(("front", "rear"), np.array(px), 1e-4 * np.eye(4), 0, 20, 0, (None, None), (0.0, 0.0))
    installation = Installation(thermometer="frame", expansion=Expansion(**changes))
    solution = BeamInstrument(made, Measuring(), installation, celsius=lambda: now_c).solve(spots)
    assert isinstance(solution, Solution), solution
    return solution


@pytest.mark.parametrize(
    ("now_c", "unsure_k"), [(60.0, math.hypot(39, 1)), (21.0, 1.0), (None, 5.0), (85.0, math.hypot(64, 1))]
)
def test_a_thermometer_on_the_frame_replaces_the_stated_temperature(
    now_c: float | None, unsure_k: float
) -> None:
    x = solved([(40, 0), (40, 0)], now_c).values["x_mm"]
    assert math.sqrt(x.sigma**2 - x.sigma_random**2) == pytest.approx(23.6e-6 * unsure_k * 40, rel=1e-3)


EXPANSION = {
    "distance_ppm_per_k": 30.0,
    "distance_sigma_ppm_per_k": 0.01,
    "view_ppm_per_k": 12.0,
    "view_sigma_ppm_per_k": 0.01,
}


def seen_cold(warmer_k: float, distance: float, view: float) -> list[tuple[float, float]]:
    """Places (x, y) at which the maps of a cold unit see a beam when it is warmer, ppm/K."""
    farther, larger = 1 + 1e-6 * distance * warmer_k, 1 + 1e-6 * view * warmer_k
    return [((-30.0 + SX * z * farther) / larger, (25.0 + SY * z * farther) / larger) for z in Z_MM]


@pytest.mark.parametrize("now_c", [-10.0, 60.0])
def test_a_known_expansion_is_corrected(now_c: float) -> None:
    truth = [-30.0, 25.0, math.degrees(math.atan(SX)), math.degrees(math.atan(SY))]
    corrected = solved(seen_cold(now_c - 21.0, 30.0, 12.0), now_c, **EXPANSION).values
    assert [corrected[key].value for key in KEYS] == pytest.approx(truth, abs=2e-5)
    uncorrected = solved(seen_cold(now_c - 21.0, 30.0, 12.0), now_c).values
    assert abs(uncorrected["pitch_deg"].value - truth[3]) > 0.006
    for key, true in zip(KEYS, truth, strict=True):
        assert abs(uncorrected[key].value - true) < 1.3 * uncorrected[key].sigma


def test_the_rest_of_a_corrected_expansion_is_in_sigma() -> None:
    """One sigma of each expansion, and of the temperature, which is in both, by differences."""
    seen = seen_cold(39.0, 30.0, 12.0)
    right = solved(seen, 60.0, **EXPANSION)
    unsure = EXPANSION | {"distance_sigma_ppm_per_k": 3.0, "view_sigma_ppm_per_k": 2.0}
    added = solved(seen, 60.0, **unsure).values
    changed = [
        solved(seen_cold(39.0, 33.0, 12.0), 60.0, **EXPANSION),
        solved(seen_cold(39.0, 30.0, 14.0), 60.0, **EXPANSION),
        solved(seen_cold(40.0, 30.0, 12.0), 60.0, **EXPANSION),
    ]
    for key in KEYS:
        value = right.values[key]
        distance, view, kelvin = (each.values[key].value - value.value for each in changed)
        assert added[key].sigma ** 2 - value.sigma**2 == pytest.approx(distance**2 + view**2, rel=0.01)
        assert value.sigma**2 - value.sigma_random**2 == pytest.approx(kelvin**2, rel=0.01)


def test_a_failed_thermometer_leaves_all_temperatures_of_operation_in_sigma() -> None:
    """Even from −10 to +60 °C, calibrated at 21 °C: about 25 °C, so 4 K aside, with 70/√12 K."""
    made = Warmth.measured(None, 21.0, None, Expansion(**EXPANSION))
    assert (made.by_k, made.sigma_k) == (0.0, pytest.approx(math.hypot(4.0, 70.0 / math.sqrt(12.0))))


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
