"""Beyond the nodes a map is known less and less, and not at all beyond its margin."""

from dataclasses import replace

import numpy as np
import pytest

from altd.mapping.grid import convex_hull_mm
from altd.mapping.inverse import InverseMap
from altd.mapping.tensor_map import TensorMap, fit_tensor_map

NODES = np.stack(np.meshgrid(np.arange(-70.0, 71, 28), np.arange(-56.0, 57, 28)), -1).reshape(-1, 2)
PX_PER_MM = 4.0


def straight(**known: float) -> TensorMap:
    px = PX_PER_MM * NODES + (376.0, 240.0) + np.random.default_rng(1).normal(0, 0.04, NODES.shape)
    return replace(fit_tensor_map(NODES, px, convex_hull_mm(NODES), (1, 1)).map, **known)


def at(fitted: TensorMap, x_mm: float, y_mm: float) -> tuple[np.ndarray, np.ndarray]:
    mm, _, covariance = InverseMap(fitted).to_mm(fitted.to_px(np.array([[x_mm, y_mm]])))
    return mm[0], covariance[0]


def test_within_the_margin_a_point_is_known_and_beyond_it_not() -> None:
    fitted = straight(margin_mm=14.0)
    assert at(fitted, 83.9, 0.0)[0] == pytest.approx([83.9, 0.0], abs=1e-6)
    assert np.isnan(at(fitted, 84.3, 0.0)[0]).all()
    assert np.isnan(at(straight(), 83.9, 0.0)[0]).all()


def test_sigma_grows_by_what_the_model_is_off_for_each_millimetre_outside() -> None:
    sure, unsure = straight(margin_mm=14.0), straight(margin_mm=14.0, beyond_px_per_mm=0.03)
    for outside_mm in (0.0, 2.0, 5.0):
        place = 0.0, 56.0 + outside_mm
        added = at(unsure, *place)[1] - at(sure, *place)[1]
        assert added == pytest.approx(np.eye(2) * (0.03 * outside_mm / PX_PER_MM) ** 2, rel=0.02, abs=1e-7)


def test_a_point_known_worse_than_the_unit_must_be_is_not_known() -> None:
    """0.06 px for each mm are 0.05 mm after 3.3 mm at 4 px/mm."""
    fitted = straight(margin_mm=14.0, beyond_px_per_mm=0.06)
    assert not np.isnan(at(fitted, 73.0, 0.0)[0]).any()
    assert np.isnan(at(fitted, 73.5, 0.0)[0]).all()


def test_a_map_that_is_off_wildly_outside_is_not_known_there_however_large_its_sigma() -> None:
    fitted = straight(margin_mm=14.0, beyond_px_per_mm=10.0)
    assert np.isnan(at(fitted, 72.0, 0.0)[0]).all()
