"""Which model becomes the map, and which nodes are left out of it."""

from __future__ import annotations

import numpy as np
import pytest
from support.lenses import SIZE, TABLE_3_2, grid, make_lens, seen

from altd.calibration.fitting import fit_nodes
from altd.mapping.grid import contains, convex_hull_mm
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import fit_tensor_map

NODES = grid()
MOST_DROPPED = 6


def bent(p: np.ndarray) -> np.ndarray:
    """No lens has it: a wave along y."""
    return np.column_stack([370 + 4 * p[:, 0] + 2 * np.sin(p[:, 1] / 20), 240 - 4 * p[:, 1]])


def wrong_window(p: np.ndarray) -> np.ndarray:
    """A deviation beyond the lens model, on top of a lens."""
    x, y = p[:, 0] / 62.5, p[:, 1] / 50
    return np.column_stack([1.5 * x**3 * y, x * y**3])


def test_a_lens_gets_a_lens_model_and_a_tensor_polynomial_that_checks_it() -> None:
    for kind in TABLE_3_2:
        rng = np.random.default_rng(1)
        fitted = fit_nodes(Nodes.ordinary(NODES, seen(make_lens(kind, rng), NODES, rng)), SIZE, MOST_DROPPED)
        assert fitted.fit.map.model in ("lens", "fisheye")
        assert fitted.cross_check.map.model == "tensor"
        assert fitted.dropped == []


def test_what_is_no_lens_gets_a_tensor_polynomial_and_a_lens_model_that_checks_it() -> None:
    px = bent(NODES) + np.random.default_rng(2).normal(0, 0.05, NODES.shape)
    fitted = fit_nodes(Nodes.ordinary(NODES, px), SIZE, MOST_DROPPED)
    assert fitted.fit.map.model == "tensor"
    assert fitted.cross_check.map.model != "tensor"


def test_a_lens_that_departs_from_its_model_gets_a_polynomial_on_top() -> None:
    rng = np.random.default_rng(3)
    lens = make_lens(TABLE_3_2[3], rng)  # of which a tensor polynomial misses much
    px = seen(lens, NODES, rng) + wrong_window(NODES)
    fitted = fit_nodes(Nodes.ordinary(NODES, px), SIZE, MOST_DROPPED)
    assert fitted.fit.map.model.endswith("+tensor")
    points = rng.uniform((-60, -48), (60, 48), (100, 2))
    truth = lens(points) + wrong_window(points)
    miss, others = (
        np.sqrt(np.mean((forward.to_px(points) - truth) ** 2))
        for forward in (fitted.fit.map, fitted.cross_check.map)
    )
    assert miss < 0.05
    assert miss < others


def test_every_model_that_was_tried_is_told_with_its_figures() -> None:
    rng = np.random.default_rng(4)
    fitted = fit_nodes(
        Nodes.ordinary(NODES, seen(make_lens(TABLE_3_2[1], rng), NODES, rng)), SIZE, MOST_DROPPED
    )
    tensors = {c.degree: c for c in fitted.candidates if c.model == "tensor"}
    assert set(tensors) == {(x, y) for x in range(1, 5) for y in range(1, 4)}  # nodes less two
    assert [c.model for c in fitted.candidates if c.degree is None] == ["lens", "fisheye"]
    assert all(min(c.map_sigma_px, c.gcv_px, c.leave_one_out_px) > 0 for c in fitted.candidates)
    assert fitted.cross_check.map.degree == min(tensors, key=lambda d: tensors[d].gcv_px)
    assert (
        min(c.leave_one_out_px for c in fitted.candidates if c.degree is None) == fitted.fit.leave_one_out_px
    )
    assert (
        tensors[4, 3].map_sigma_px
        > 1.5 * next(c for c in fitted.candidates if c.model == "lens").map_sigma_px
    )


def test_without_its_corner_the_map_does_not_reach_there() -> None:
    rng = np.random.default_rng(9)
    px = seen(make_lens(TABLE_3_2[1], rng), NODES, rng)
    px[0] += 10.0
    fitted = fit_nodes(Nodes.ordinary(NODES, px), SIZE, 3)
    assert fitted.dropped == [0]
    assert contains(fitted.fit.map.hull_mm, NODES).tolist() == [False, *[True] * 29]


def test_positions_need_not_be_those_that_were_meant() -> None:
    rng = np.random.default_rng(7)
    lens = make_lens(TABLE_3_2[1], rng)
    reached = NODES + rng.normal(0, 0.3, NODES.shape)  # and the stage reports them
    fitted = fit_nodes(Nodes.ordinary(reached, seen(lens, reached, rng)), SIZE, MOST_DROPPED)
    points = rng.uniform((-60, -48), (60, 48), (100, 2))
    assert fitted.dropped == []
    assert fitted.fit.map.to_px(points) == pytest.approx(lens(points), abs=0.1)


def test_a_map_never_folds_over_on_itself() -> None:
    folded = np.column_stack([400 - 0.05 * (NODES[:, 0] - 20) ** 2, 240 - 4 * NODES[:, 1]])
    px = folded + np.random.default_rng(8).normal(0, 0.01, NODES.shape)
    fitted = fit_nodes(Nodes.ordinary(NODES, px), SIZE, 0)
    assert fit_tensor_map(NODES, px, convex_hull_mm(NODES)).map.folds
    assert not fitted.fit.map.folds
    assert not fitted.cross_check.map.folds
