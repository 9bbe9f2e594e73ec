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


def test_what_the_nodes_leave_in_the_map_is_that_of_monte_carlo_at_every_place() -> None:
    """The map's own share alone, without the spot's: of one lens, at its corners and in its middle."""
    rng = np.random.default_rng(2)
    lens = make_lens(TABLE_3_2[1], rng)
    places = np.array([[0.0, 0.0], [62.5, 50.0], [-62.5, 0.0], [25.0, -50.0]])
    maps = [brown(seen(lens, NODES, rng)).map for _ in range(150)]
    scatter = np.std([one.to_px(places) for one in maps], axis=0)
    predicted = []
    for one in maps:
        inverse = InverseMap.of(one)
        _, jacobian, covariance = inverse.to_mm(one.to_px(places))
        forward = np.linalg.inv(jacobian)
        own = forward @ covariance @ forward.transpose(0, 2, 1) - one.noise_px**2 * np.eye(2)
        predicted.append(np.diagonal(own, axis1=1, axis2=2))
    assert np.sqrt(np.mean(predicted, axis=0)) / scatter == pytest.approx(1.0, abs=0.2)
