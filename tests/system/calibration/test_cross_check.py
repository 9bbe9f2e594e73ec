"""The second map on good units: silent everywhere."""

import pytest
from support.cross_checked import difference_px, fitted_unit
from support.lenses import TABLE_3_2, LensKind


@pytest.mark.parametrize("kind", TABLE_3_2, ids=str)
def test_on_good_units_the_maps_agree_everywhere(kind: LensKind) -> None:
    for seed in range(6):
        fitted, rng = fitted_unit(kind, seed)
        points = rng.uniform((-62.5, -50), (62.5, 50), (300, 2))
        apart = difference_px(fitted, fitted.fit.map, points)
        assert apart.max() < 0.7 * fitted.cross_check.limit_px
        assert apart.max() <= fitted.cross_check.max_difference_px * 1.1
        assert fitted.cross_check.max_difference_px <= apart.max() * 2
