"""The uncertainty budget against closed forms and printed tables."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from support.evidence import DISTANCE_MM, calibration, evidence, target
from support.recordings import PX_PER_MM

from altd.calibration.report.budget import Budget, Term, beams_of, budget_of, budget_section, student_quantile
from altd.calibration.report.document import Table, Words
from altd.records import Glass, Limits

LIMITS = Limits(0.005, 50.0, 0.05, 0.3, 0.05)
EVIDENCE = (evidence("front"), evidence("rear", 2))


@pytest.fixture(scope="module")
def budget() -> Budget:
    return budget_of(replace(calibration(), limits=LIMITS), EVIDENCE, exposures=20)


def term(budget: Budget, key: str) -> Term:
    (found,) = (each for each in budget.terms if each.key == key)
    return found


@pytest.mark.parametrize(
    ("degrees_of_freedom", "printed"),
    [(6, 2.447), (8, 2.306), (10, 2.228), (30, 2.042), (120, 1.980), (math.inf, 1.960)],
)
def test_coverage_factors_are_those_of_the_tables(degrees_of_freedom: float, printed: float) -> None:
    """Two-sided 95 % points of Student's distribution (GUM, table G.2, and any table of statistics)."""
    assert student_quantile(0.975, degrees_of_freedom) == pytest.approx(printed, abs=0.0025)


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
        assert budget.expanded[at] == pytest.approx(budget.coverage_factors[at] * combined)
        assert 1.959 < budget.coverage_factors[at] < 2.1


def test_a_term_that_is_known_from_few_readings_raises_the_factor() -> None:
    """GUM, H.1.6: five terms with 18, 25.6, infinite and 50 degrees of freedom."""
    terms = [("a", 25.0, 18), ("b", 9.7, 25.6), ("c", 2.9, 50), ("d", 16.6, 2)]
    made = Budget(("x_mm",), tuple(Term(k, u, "nm", "normal, type A", f, (u,)) for k, u, f in terms), (), 1)
    assert made.combined[0] == pytest.approx(31.7, abs=0.05)
    assert made.degrees_of_freedom[0] == pytest.approx(16.7, abs=0.1)
    assert made.coverage_factors[0] == pytest.approx(2.11, abs=0.01)


def test_limits_that_are_not_stated_are_named(budget: Budget) -> None:
    none = budget_of(calibration(), EVIDENCE)
    assert none.not_stated == (
        *("stage_mm", "stage_scale_ppm", "stage_square_mrad", "beam_normal_mm_per_m", "target_distance_mm"),
        "glass_mm",
    )
    assert [each.key for each in none.terms] == ["pattern", "map", "scatter"]
    (words,) = (block for block in budget_section(none) if isinstance(block, Words))
    assert "Not stated, so not contained: positioning of the stage, scale of the stage" in words.text
    assert budget.not_stated == ("glass_mm",)


def test_glass_that_is_stated_has_two_terms() -> None:
    """Each is largest at the largest slopes, 0.0017° and 0.0009° (docs/refraction.md), and 0 without one."""
    front, rear = calibration().targets
    with_glass = replace(calibration(), targets=(replace(front, glass=Glass(4.0)), rear))
    made = budget_of(with_glass, EVIDENCE)
    assert "glass_mm" not in made.not_stated
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
    keys = {"pattern", "map", "scatter", "stage_scale_ppm", "stage_square_mrad"}
    assert {each.key for each in one.terms} == keys
