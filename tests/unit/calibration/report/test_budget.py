"""The uncertainty that a report states, against closed forms, printed tables and Monte Carlo."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from support.evidence import DISTANCE_MM, calibration, evidence, nodes_mm, straight_map, straight_px, target
from support.recordings import PX_PER_MM

from altd.calibration.report.budget import (
    Budget,
    Term,
    beams_of,
    budget_of,
    budget_section,
    combine,
    student_quantile,
)
from altd.calibration.report.document import Table, Words
from altd.calibration.report.prediction import (
    difference_mm,
    node_covariance_px2,
    noise_in_map_px,
    offsets_mm,
    predict,
    spectrum_covariance_px2,
)
from altd.calibration.result import Candidate
from altd.mapping.grid import convex_hull_mm
from altd.mapping.tensor_map import fit_tensor_map
from altd.records import Glass, Limits

LIMITS = Limits(0.005, 50.0, 0.05, 0.3, 0.05, 8.0)
EVIDENCE = (evidence("front"), evidence("rear", 2))


@pytest.fixture(scope="module")
def budget() -> Budget:
    return budget_of(replace(calibration(), limits=LIMITS), EVIDENCE, exposures=20)


def term(budget: Budget, key: str) -> Term:
    (found,) = (each for each in budget.terms if each.key == key)
    return found


@pytest.mark.parametrize("probability", [0.95, 0.975, 0.995])
def test_quantiles_of_student_are_those_of_scipy(probability: float) -> None:
    for free in (*range(6, 200), 1e4, math.inf):
        expected = scipy.stats.t.ppf(probability, free)
        assert student_quantile(probability, free) == pytest.approx(expected, rel=0.006), free
        if probability <= 0.975:
            assert student_quantile(probability, free) == pytest.approx(expected, rel=0.001), free


def test_terms_are_those_of_the_formulas(budget: Budget) -> None:
    pattern_mm = 0.03 / PX_PER_MM
    assert term(budget, "pattern").contributions[:2] == pytest.approx([pattern_mm] * 2, rel=1e-6)
    assert term(budget, "scatter").value == pytest.approx(0.02 / PX_PER_MM / math.sqrt(20), rel=1e-6)
    slopes = np.array([(b[1].x_mm - b[0].x_mm, b[1].y_mm - b[0].y_mm) for b in beams_of(calibration())])
    slopes /= DISTANCE_MM
    cos2 = 1 / (1 + np.square(slopes))
    tilt = term(budget, "beam_normal_mm_per_m")
    expected = np.degrees(0.3e-3 * np.sqrt(np.square(cos2).mean(axis=0)))
    assert tilt.contributions == pytest.approx([0.0, 0.0, *expected], rel=1e-6, abs=1e-12)
    distance = np.degrees(0.05 / DISTANCE_MM * np.sqrt(np.square(slopes * cos2).mean(axis=0)))
    assert term(budget, "target_distance_mm").contributions[2:] == pytest.approx(distance, rel=1e-6)


def test_beams_have_slopes_up_to_the_stated_range_and_meet_both_targets() -> None:
    beams = beams_of(calibration())
    slopes = np.array([(b[1].x_mm - b[0].x_mm, b[1].y_mm - b[0].y_mm) for b in beams]) / DISTANCE_MM
    assert np.abs(slopes).max(axis=0) == pytest.approx([0.110, 0.250], rel=1e-6)
    places = np.array([[(p.x_mm, p.y_mm) for p in b] for b in beams])
    assert np.abs(places).max(axis=(0, 1)) == pytest.approx([62.5, 50])


def test_the_sum_is_the_root_of_the_squares_and_expands_by_its_factor(budget: Budget) -> None:
    for at, combined in enumerate(budget.combined):
        assert combined == pytest.approx(math.hypot(*(each.contributions[at] for each in budget.terms)))
        factor = scipy.stats.t.ppf(0.975, budget.rms[at].degrees_of_freedom)
        assert budget.expanded[at] == pytest.approx(factor * combined, rel=1e-3)
        assert 1.959 < factor < 2.1


def test_a_term_that_is_known_from_few_readings_raises_the_factor() -> None:
    """GUM, H.1.6: five terms with 18, 25.6, infinite and 50 degrees of freedom."""
    terms = [("a", 25.0, 18), ("b", 9.7, 25.6), ("c", 2.9, 50), ("d", 16.6, 2)]
    (made,) = combine([(key, (free,), np.array([[u * u]])) for key, u, free in terms])
    assert made.standard == pytest.approx(31.7, abs=0.05)
    assert made.degrees_of_freedom == pytest.approx(16.7, abs=0.1)
    assert made.coverage_factor == pytest.approx(2.11, abs=0.01)


def test_terms_from_one_estimate_cover_as_they_state() -> None:
    """Monte Carlo: one standard deviation, estimated from 8 readings more than needed, scales both terms."""
    parts = [("pattern", (8.0,), np.array([[9.0]])), ("map", (8.0,), np.array([[16.0]]))]
    (made,) = combine(parts)
    rng = np.random.default_rng(5)
    errors = rng.normal(0, 3, 200_000) + rng.normal(0, 4, 200_000)
    estimated = np.sqrt(rng.chisquare(8, 200_000) / 8)
    within = np.abs(errors) <= made.expanded * estimated
    assert within.mean() == pytest.approx(0.95, abs=0.002)


def test_two_targets_are_two_estimates() -> None:
    """x is that of the front target alone; yaw has equal parts of both."""
    at_rest = calibration(target("front", scatter_px=0.0), target("rear", scatter_px=0.0))
    found = budget_of(at_rest, EVIDENCE).rms
    nodes = 2 * 30 - 8
    assert found[0].degrees_of_freedom == pytest.approx(nodes)
    assert found[2].degrees_of_freedom == pytest.approx(2 * nodes)


def test_the_worst_place_is_the_edge_that_the_stage_reaches() -> None:
    long = replace(calibration(), limits=Limits(stage_scale_ppm=1000.0))
    found = budget_of(long, EVIDENCE)
    own_mm = budget_of(calibration(), EVIDENCE).rms[0].standard
    assert found.worst[0].standard == pytest.approx(math.hypot(1e-3 * 62.5, own_mm), rel=1e-3)
    assert found.rms[0].standard < 0.8 * found.worst[0].standard


def test_limits_that_are_not_stated_are_named(budget: Budget) -> None:
    none = budget_of(calibration(), EVIDENCE)
    assert none.not_stated == (
        *("stage_mm", "stage_scale_ppm", "stage_square_mrad", "beam_normal_mm_per_m", "target_distance_mm"),
        "temperature_k",
        "glass_mm",
    )
    assert [each.key for each in none.terms] == ["pattern", "map", "scatter"]
    (words,) = (block for block in budget_section(none) if isinstance(block, Words))
    assert "Not stated, so not contained: positioning of the stage, scale of the stage" in words.text
    assert budget.not_stated == ("glass_mm",)


def test_glass_that_is_stated_has_two_terms() -> None:
    """Each is largest at the largest slopes, 0.0017° and 0.0009°, and 0 without one."""
    front, rear = calibration().targets
    with_glass = replace(calibration(), targets=(replace(front, glass=Glass(4.0)), rear))
    made = budget_of(with_glass, EVIDENCE)
    assert "glass_mm" not in made.not_stated
    none = replace(calibration(), targets=(replace(front, glass=Glass(0.0)), rear))
    assert "glass_mm" not in budget_of(none).not_stated
    slopes = np.array([(b[1].x_mm - b[0].x_mm, b[1].y_mm - b[0].y_mm) for b in beams_of(calibration())])
    theta = np.arctan(np.linalg.norm(slopes / DISTANCE_MM, axis=1))
    inner = np.arcsin(np.sin(theta) / 1.52)
    of_thickness = 0.1 * np.sqrt(np.mean((np.tan(theta) - np.tan(inner)) ** 2)) / DISTANCE_MM
    found = term(made, "glass_mm").contributions
    assert math.hypot(*found[2:]) == pytest.approx(math.degrees(of_thickness), rel=0.05)
    assert found[:2] == pytest.approx((0, 0), abs=1e-9)
    assert 0 < math.hypot(*term(made, "glass_index").contributions[2:]) < math.hypot(*found[2:])


def test_json_and_table_have_the_same_numbers(budget: Budget) -> None:
    document = json.loads(json.dumps(budget.as_object()))
    (table,) = (block for block in budget_section(budget) if isinstance(block, Table))
    shown = {row[0]: row[4:] for row in table.rows}
    for each in document["terms"]:
        assert shown[each["name"]] == tuple(f"{each['contribution'][key]:.4f}" for key in budget.quantities)
    expanded = dict(zip(budget.quantities, budget.expanded, strict=True))
    assert document["expanded"] == pytest.approx(expanded, rel=1e-3)
    assert document["terms"][-1]["degrees_of_freedom"] is None


def test_a_single_target_has_the_budget_of_its_spot() -> None:
    one = budget_of(replace(calibration(target("front")), limits=LIMITS), EVIDENCE[:1])
    assert one.quantities == ("x_mm", "y_mm")
    keys = {"pattern", "map", "scatter", "stage_scale_ppm", "stage_square_mrad", "temperature_k"}
    assert {each.key for each in one.terms} == keys


PATTERN_PX, SHIFT_PX, SCATTER_PX = 0.03, 0.01, 0.02


def test_sigma_of_straight_maps_is_the_closed_form_everywhere() -> None:
    prediction = predict(calibration(), exposures=16)
    one_mm = math.sqrt(PATTERN_PX**2 + SHIFT_PX**2 + SCATTER_PX**2 / 16) / PX_PER_MM
    assert prediction.sigma[:2] == pytest.approx(np.full_like(prediction.sigma[:2], one_mm), rel=1e-6)
    angle_deg = math.degrees(math.sqrt(2) * one_mm / DISTANCE_MM)
    assert prediction.sigma[2:] == pytest.approx(np.full_like(prediction.sigma[2:], angle_deg), rel=1e-6)


def test_the_shares_are_those_of_the_variances() -> None:
    prediction = predict(calibration(), exposures=1)
    parts = np.square([PATTERN_PX, SHIFT_PX, SCATTER_PX])
    assert prediction.shares[:, :3] == pytest.approx(np.tile(parts / parts.sum(), (4, 1)), rel=1e-6)
    assert not prediction.shares[:, 3].any(), "no limit is stated"


def test_stated_limits_have_their_share() -> None:
    """A beam tilted by 0.3 mm/m moves yaw and pitch by that, and x and y not at all."""
    tilted = replace(calibration(), limits=Limits(beam_normal_mm_per_m=0.3))
    before, after = predict(calibration()), predict(tilted)
    added_deg = math.degrees(0.3e-3)
    assert after.rms("x_mm") == pytest.approx(before.rms("x_mm"))
    assert after.rms("yaw_deg") == pytest.approx(math.hypot(before.rms("yaw_deg"), added_deg), rel=1e-6)
    assert after.shares[2, 3] == pytest.approx((added_deg / after.rms("yaw_deg")) ** 2, rel=1e-6)


def test_targets_of_unlike_quality_count_by_their_own_errors() -> None:
    prediction = predict(calibration(target("front", pattern_px=0.01), target("rear", pattern_px=0.1)), 10**6)
    front_mm, rear_mm = (math.hypot(pattern, SHIFT_PX) / PX_PER_MM for pattern in (0.01, 0.1))
    assert prediction.rms("x_mm") == pytest.approx(front_mm, rel=1e-4)
    expected_deg = math.degrees(math.hypot(front_mm, rear_mm) / DISTANCE_MM)
    assert prediction.rms("yaw_deg") == pytest.approx(expected_deg, rel=1e-4)


def test_averaging_more_takes_away_the_scatter_alone() -> None:
    windows = np.array([1.0, 5.0, 100.0])
    after = predict(calibration(), exposures=20).rms_after("pitch_deg", windows)
    expected = [predict(calibration(), exposures=round(n)).rms("pitch_deg") for n in windows]
    assert after == pytest.approx(expected, rel=1e-6)


def test_outside_a_hull_nothing_is_predicted() -> None:
    rear = target("rear")
    corner_off = nodes_mm()[~(nodes_mm() > (50, 40)).all(axis=1)]
    rear = replace(rear, map=replace(rear.map, hull_mm=convex_hull_mm(corner_off)))
    prediction = predict(calibration(target("front"), rear))
    assert np.isnan(prediction.sigma[:, -1, -1]).all()
    assert np.isfinite(prediction.sigma[:, -1, 0]).all()
    assert np.isfinite(prediction.sigma[0]).mean() == pytest.approx(1 - 0.5 / 20, abs=0.01)


def test_targets_without_a_common_area_are_refused() -> None:
    rear = target("rear")
    aside = replace(rear.map, hull_mm=rear.map.hull_mm + np.array([0.0, 200.0]))
    with pytest.raises(ValueError, match="no calibrated area in common"):
        predict(calibration(target("front"), replace(rear, map=aside)))


def test_a_shifted_second_map_differs_by_its_shift() -> None:
    """A spot stays where it is: a map whose picture lies further right puts it further left."""
    for name, mirror in (("front", -1), ("rear", 1)):
        own = target(name)
        places = nodes_mm()
        rng = np.random.default_rng(1)
        shifted = straight_px(name, places) + np.array([0.2, 0.1]) + rng.normal(0, 1e-6, places.shape)
        other = fit_tensor_map(places, shifted, own.map.hull_mm, (1, 1)).map
        off = difference_mm(own, other, places)
        expected = (-mirror * 0.2 / PX_PER_MM, 0.1 / PX_PER_MM)
        assert off == pytest.approx(np.tile(expected, (len(places), 1)), abs=1e-5)


def test_offsets_in_the_picture_turn_with_the_camera() -> None:
    off = offsets_mm(target("front"), nodes_mm()[:3], np.array([[4.0, 0.0], [0.0, 4.0], [0.0, 0.0]]))
    assert off == pytest.approx(np.array([[-1.0, 0.0], [0.0, -1.0], [0.0, 0.0]]), abs=1e-4)


def test_the_covariance_of_the_nodes_is_that_of_the_thesis() -> None:
    """Eq. 3.53 with an orthonormal basis that QR makes, not altd's own."""
    places = nodes_mm()
    rng = np.random.default_rng(2)
    noisy = straight_px("rear", places) + rng.normal(0, 0.05, places.shape)
    fitted = fit_tensor_map(places, noisy, convex_hull_mm(places), (3, 2)).map
    bx, _ = np.linalg.qr(np.vander(np.arange(6.0), 4))
    by, _ = np.linalg.qr(np.vander(np.arange(5.0), 3))
    expected = fitted.noise_px**2 * np.kron(bx @ bx.T, by @ by.T)
    assert node_covariance_px2(fitted, rng.permutation(places)) == pytest.approx(expected, abs=1e-9)
    spectrum = spectrum_covariance_px2(fitted)
    assert spectrum == pytest.approx(fitted.noise_px**2 * np.eye(12), abs=1e-9)


def test_of_a_thousand_nodes_the_covariance_of_every_second_is_shown() -> None:
    x_mm, y_mm = np.meshgrid(np.linspace(-70, 70, 40), np.linspace(-55, 55, 25))
    places = np.column_stack([x_mm.ravel(), y_mm.ravel()])
    nodes = nodes_mm()
    fitted = fit_tensor_map(nodes, straight_px("rear", nodes), convex_hull_mm(nodes), (3, 2)).map
    noisy = replace(
        fitted,
        covariance_factor_px=np.random.default_rng(1).normal(0, 0.01, fitted.covariance_factor_px.shape),
    )
    shown = node_covariance_px2(noisy, places)
    assert shown.shape == (500, 500)
    by_columns = places[np.argsort(places[:, 0] * 1000 + places[:, 1])]
    variances = noisy.variance_px2(by_columns[::2])[:, 0]
    assert shown.diagonal() == pytest.approx(variances)


def test_a_map_without_errors_has_no_covariance() -> None:
    assert not node_covariance_px2(straight_map("front", shift_px=0.0), nodes_mm()).any()


@pytest.mark.parametrize("degree", [(1, 1), (2, 3), (4, 3)])
def test_the_noise_in_a_map_is_that_of_many_calibrations(degree: tuple[int, int]) -> None:
    """Monte Carlo: scans of a straight target, each with its own noise; what all maps scatter by."""
    places, noise_px = nodes_mm(), 0.05
    hull = convex_hull_mm(places)
    rng = np.random.default_rng(3)
    fits = [
        fit_tensor_map(
            places, straight_px("rear", places) + rng.normal(0, noise_px, places.shape), hull, degree
        )
        for _ in range(200)
    ]
    dense_mm = fits[0].map.dense_mm()
    scattered = np.array([fit.map.to_px(dense_mm) for fit in fits])
    expected_px = float(np.sqrt(scattered.var(axis=0, ddof=1).mean()))
    one = fits[0]
    errors_px = one.gcv_px, one.leave_one_out_px, one.map.sigma_px
    candidate = Candidate("tensor", degree, one.parameters, *errors_px)
    assert noise_in_map_px(candidate, len(places), noise_px) == pytest.approx(expected_px, rel=0.05)


def test_a_map_with_no_freedom_left_says_nothing_of_its_noise() -> None:
    assert np.isnan(noise_in_map_px(Candidate("tensor", (5, 4), 60, 0.0, 0.0, 0.0), 30, 0.05))
