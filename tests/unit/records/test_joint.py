import math

import numpy as np
import pytest

from altd.records.joint import correlation_of, is_definite


def test_products_give_correlations_and_a_quantity_without_any_has_none() -> None:
    assert correlation_of(np.array([[4.0, -3.0, 0.0], [-3.0, 9.0, 0.0], [0.0, 0.0, -1.0]]), True) == [
        [1.0, -0.5, 0.0],
        [-0.5, 1.0, 0.0],
        [0.0, 0.0, 1.0],
    ]


def test_an_estimate_gets_the_nearest_matrix_without_negative_eigenvalues() -> None:
    """Two quantities whose estimated correlation is 1.5 move as one."""
    found = correlation_of(np.array([[1.0, 3.0], [3.0, 4.0]]), is_estimate=True)
    assert np.array(found) == pytest.approx(np.ones((2, 2)))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_products_that_are_not_finite_have_no_correlations(value: float) -> None:
    assert np.isnan(correlation_of(np.array([[value, 0.0], [0.0, 1.0]]), is_estimate=True)).all()


def test_definite_is_what_has_eigenvalues_above_the_slack() -> None:
    random = np.random.default_rng(1)
    for _ in range(200):
        vectors, _ = np.linalg.qr(random.normal(size=(4, 4)))
        lowest = random.choice([-2e-6, -1.01e-6, -0.99e-6, 0.0, 1.0])
        matrix = (vectors * [lowest, 0.1, 1.0, 3.0]) @ vectors.T
        assert is_definite(matrix.tolist(), [1e-6] * 4) == (lowest > -1e-6)
