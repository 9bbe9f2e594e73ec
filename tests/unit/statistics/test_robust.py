import statistics

import numpy as np
import pytest

from altd.statistics import MAD_TO_SIGMA, mad_sigma, median


@pytest.mark.parametrize("count", [1, 2, 5, 20, 21])
@pytest.mark.parametrize("axis", [0, 1, -1])
def test_the_median_is_that_of_the_standard_library(count: int, axis: int) -> None:
    values = np.random.default_rng(count).normal(0, 3, (count, 4) if axis == 0 else (4, count))
    lines = values.T if axis == 0 else values
    assert median(values, axis=axis).tolist() == [statistics.median(line.tolist()) for line in lines]


def test_the_type_of_the_values_stays() -> None:
    """Tiles of a picture are float32, and a picture in float64 would be twice as much to carry."""
    assert median(np.array([1, 2, 4, 5], np.float32)).dtype == np.float32


def test_of_gaussian_values_the_mad_gives_sigma_and_a_fifth_of_outliers_hardly_count() -> None:
    values = np.random.default_rng(1).normal(0, 2.5, 40_000)
    assert mad_sigma(np.abs(values)) == pytest.approx(2.5, rel=0.02)
    values[::5] = 1e6
    assert mad_sigma(np.abs(values)) < 1.4 * 2.5
    assert pytest.approx(1 / statistics.NormalDist().inv_cdf(0.75), abs=1e-4) == MAD_TO_SIGMA
