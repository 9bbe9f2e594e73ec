"""The slope that says whether the page's memory grows: told from noise and from a heap that is emptied."""

import numpy as np
import pytest

from benchmarks.page.memory import slope_of

T_S = np.arange(600.0, 3600.0, 30.0)


def test_a_straight_line_has_its_own_slope_and_no_uncertainty() -> None:
    slope = slope_of(T_S, 100 + 7.2 * T_S / 3600)
    assert slope.per_h == pytest.approx(7.2)
    assert slope.sigma_per_h == pytest.approx(0.0, abs=1e-9)
    assert slope.grows


def test_noise_gives_slopes_that_scatter_as_their_sigma_says() -> None:
    """Of 8 degrees of freedom 0.9 % lie above 3 standard errors (Student's t)."""
    random = np.random.default_rng(1)
    found = [slope_of(T_S, 100 + random.normal(0, 3, T_S.size)) for _ in range(1000)]
    per_h = np.array([slope.per_h for slope in found])
    expected = 3 / np.sqrt(((T_S / 3600 - (T_S / 3600).mean()) ** 2).sum())
    assert per_h.std() == pytest.approx(expected, rel=0.15)
    assert np.median([slope.sigma_per_h for slope in found]) == pytest.approx(expected, rel=0.15)
    assert sum(slope.grows for slope in found) < 20


def test_a_heap_that_fills_and_empties_does_not_grow() -> None:
    assert not slope_of(T_S, 10 + (T_S % 270) / 100).grows


def test_a_small_growth_within_a_large_saw_is_found() -> None:
    assert slope_of(T_S, 10 + (T_S % 90) / 300 + 2 * T_S / 3600).grows


def test_a_growth_below_a_hundredth_of_the_whole_is_none() -> None:
    assert not slope_of(T_S, 100 + 0.9 * T_S / 3600).grows


def test_few_values_show_no_slope() -> None:
    with pytest.raises(ValueError, match="5 values show no slope"):
        slope_of(T_S[:5], T_S[:5])
