"""Is sigma honest? Noise on nodes and spots, many times over, against the sigma of the maps."""

from __future__ import annotations

import numpy as np
import pytest
from support.lenses import SIZE, TABLE_3_2, grid, make_lens, seen

from altd.mapping.grid import convex_hull_mm
from altd.mapping.inverse import InverseMap
from altd.mapping.lens import fit_lens_map
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import Fit

NODES = grid()
HULL = convex_hull_mm(NODES)


def brown(px: np.ndarray) -> Fit:
    return fit_lens_map(Nodes.ordinary(NODES, px), HULL, SIZE)


@pytest.mark.long
def test_what_the_nodes_leave_in_the_map_is_that_of_monte_carlo_at_every_place() -> None:
    """The map's own share alone, without the spot's: of one lens, at its corners and in its middle."""
    rng = np.random.default_rng(2)
    lens = make_lens(TABLE_3_2[1], rng)
    places = np.array([[0.0, 0.0], [62.5, 50.0], [-62.5, 0.0], [25.0, -50.0]])
    maps = [brown(seen(lens, NODES, rng)).map for _ in range(150)]
    scatter = np.std([one.to_px(places) for one in maps], axis=0)
    predicted = []
    for one in maps:
        inverse = InverseMap(one)
        _, jacobian, covariance = inverse.to_mm(one.to_px(places))
        forward = np.linalg.inv(jacobian)
        own = forward @ covariance @ forward.transpose(0, 2, 1) - one.noise_px**2 * np.eye(2)
        predicted.append(np.diagonal(own, axis1=1, axis2=2))
    assert np.sqrt(np.mean(predicted, axis=0)) / scatter == pytest.approx(1.0, abs=0.2)


@pytest.mark.long
def test_noise_that_is_larger_along_u_is_so_in_the_map_too() -> None:
    rng = np.random.default_rng(3)
    lens = make_lens(TABLE_3_2[1], rng)
    middle, noise_px = np.zeros((1, 2)), np.array([0.06, 0.02])
    found, predicted = [], []
    for _ in range(100):
        one = brown(lens(NODES) + rng.normal(0, 1, NODES.shape) * noise_px).map
        back = np.linalg.inv(one.jacobian(middle)[0])
        shaped = one.with_noise(one.noise_px, back @ np.diag(noise_px**2) @ back.T)
        assert np.diag(shaped.noise_covariance_px2) == pytest.approx(
            one.noise_px**2 * np.array([1.8, 0.2]), rel=0.02
        )
        found.append(one.to_px(middle)[0])
        predicted.append(shaped.variance_px2(middle)[0])
        _, jacobian, covariance = InverseMap(shaped).to_mm(one.to_px(middle))
        forward = np.linalg.inv(jacobian[0])
        of_place = forward @ covariance[0] @ forward.T - shaped.noise_covariance_px2
        assert np.diag(of_place) == pytest.approx(shaped.variance_px2(middle)[0], rel=1e-6)
    assert np.sqrt(np.mean(predicted, axis=0)) / np.std(found, axis=0) == pytest.approx(1.0, abs=0.3)
