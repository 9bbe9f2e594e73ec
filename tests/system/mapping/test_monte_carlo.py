"""Is sigma honest? Noise on nodes and spots, many times over, against the sigma of the maps."""

from collections.abc import Callable

import numpy as np
import pytest
from support.lenses import NOISE_PX, SIZE, TABLE_3_2, LensKind, grid, make_lens, seen

from altd.mapping.grid import convex_hull_mm
from altd.mapping.inverse import InverseMap
from altd.mapping.lens import fit_lens_map
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import Fit, fit_tensor_map

NODES = grid()
HULL = convex_hull_mm(NODES)
SPOTS = 20
Fitter = Callable[[np.ndarray], Fit]


def fixed_tensor(px: np.ndarray) -> Fit:
    return fit_tensor_map(NODES, px, HULL, (4, 3))


def chosen_tensor(px: np.ndarray) -> Fit:
    return fit_tensor_map(NODES, px, HULL)


def brown(px: np.ndarray) -> Fit:
    return fit_lens_map(Nodes.ordinary(NODES, px), HULL, SIZE)


def fisheye(px: np.ndarray) -> Fit:
    return fit_lens_map(Nodes.ordinary(NODES, px), HULL, SIZE, "fisheye")


@pytest.mark.parametrize(
    ("fit", "kind", "repeats"),
    [
        (fixed_tensor, TABLE_3_2[1], 600),
        (chosen_tensor, TABLE_3_2[1], 150),
        (brown, TABLE_3_2[1], 120),
        (fisheye, TABLE_3_2[3], 120),
    ],
)
def test_the_published_covariance_is_that_of_monte_carlo(fit: Fitter, kind: LensKind, repeats: int) -> None:
    rng = np.random.default_rng(1)
    squares, variances = np.zeros(2), np.zeros(2)
    for _ in range(repeats):
        lens = make_lens(kind, rng)
        truth_mm = rng.uniform((-60, -48), (60, 48), (SPOTS, 2))
        inverse = InverseMap(fit(seen(lens, NODES, rng)).map)
        found, _, covariance = inverse.to_mm(seen(lens, truth_mm, rng, NOISE_PX))
        squares += np.square(found - truth_mm).mean(axis=0)
        variances += np.diagonal(covariance, axis1=1, axis2=2).mean(axis=0)
    assert np.sqrt(variances / squares) == pytest.approx(1.0, abs=0.05)
