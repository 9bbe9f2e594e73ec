"""Displaced nodes among good and dark ones, many times over."""

import numpy as np
import pytest
from support.lenses import SIZE, TABLE_3_2, LensKind, grid, make_lens, seen

from altd.calibration.fitting import fit_nodes
from altd.mapping.nodes import Nodes

NODES = grid()
MOST_DROPPED = 6


@pytest.mark.parametrize(
    ("node", "kind"),
    [(0, TABLE_3_2[0]), (5, TABLE_3_2[1]), (9, TABLE_3_2[2]), (14, TABLE_3_2[3]), (27, TABLE_3_2[2])],
)
def test_a_node_displaced_by_2_mm_is_found_beside_dark_ones(node: int, kind: LensKind) -> None:
    rng = np.random.default_rng(node)
    lens = make_lens(kind, rng)
    dark = rng.choice(np.delete(np.arange(30), node), 3, replace=False)
    reached = NODES.copy()
    direction = rng.uniform(0, 2 * np.pi)
    reached[node] += 2 * np.array([np.cos(direction), np.sin(direction)])
    px = seen(lens, reached, rng)
    rows = np.delete(np.arange(30), dark)
    fitted = fit_nodes(Nodes.ordinary(NODES[rows], px[rows]), SIZE, 3)
    assert rows[fitted.dropped].tolist() == [node]
    points = fitted.fit.map.dense_mm()
    assert np.abs(fitted.fit.map.to_px(points) - lens(points)).max() < 0.2


def test_two_displaced_nodes_are_found() -> None:
    rng = np.random.default_rng(6)
    lens = make_lens(TABLE_3_2[2], rng)
    reached = NODES.copy()
    reached[7] += (2.0, 0.0)
    reached[24] += (0.0, 1.5)
    fitted = fit_nodes(Nodes.ordinary(NODES, seen(lens, reached, rng)), SIZE, MOST_DROPPED)
    assert fitted.dropped == [7, 24]


def test_ordinary_nodes_are_all_kept_however_the_noise_falls() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        kind = TABLE_3_2[seed % 4]
        assert (
            fit_nodes(
                Nodes.ordinary(NODES, seen(make_lens(kind, rng), NODES, rng)), SIZE, MOST_DROPPED
            ).dropped
            == []
        )
