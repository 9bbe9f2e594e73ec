from __future__ import annotations

import numpy as np
import pytest
from support.evidence import nodes_mm, straight_px

from altd.calibration.report.prediction import noise_in_map_px
from altd.calibration.result import Candidate
from altd.mapping.grid import convex_hull_mm
from altd.mapping.tensor_map import fit_tensor_map


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
    candidate = Candidate(
        "tensor", degree, one.parameters, one.gcv_px, one.leave_one_out_px, one.map.sigma_px
    )
    assert noise_in_map_px(candidate, len(places), noise_px) == pytest.approx(expected_px, rel=0.05)


def test_a_map_with_no_freedom_left_says_nothing_of_its_noise() -> None:
    assert np.isnan(noise_in_map_px(Candidate("tensor", (5, 4), 60, 0.0, 0.0, 0.0), 30, 0.05))
