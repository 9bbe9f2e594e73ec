"""The inverse must never give a number for a pixel that no place inside the hull has."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.lenses import TABLE_3_2, grid, make_lens

from altd.mapping.grid import convex_hull_mm, edge_lines
from altd.mapping.inverse import InverseMap
from altd.mapping.lens import fit_lens_map
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import TensorMap, fit_tensor_map

NODES = grid()
HULL = convex_hull_mm(NODES)
LENS = make_lens(TABLE_3_2[2], np.random.default_rng(1))


def ordinary() -> TensorMap:
    px = LENS(NODES) + np.random.default_rng(2).normal(0, 0.05, NODES.shape)
    return fit_tensor_map(NODES, px, HULL, (3, 3)).map


def parabola(p: np.ndarray) -> np.ndarray:
    """u turns back at x = 20 mm."""
    return np.column_stack([400 - 0.05 * (p[:, 0] - 20) ** 2, 240 - 4 * p[:, 1]])


def outside_mm(points: np.ndarray) -> np.ndarray:
    lines = edge_lines(HULL)
    return np.asarray((points @ lines[:, :2].T - lines[:, 2]).max(axis=1))


def test_pixels_from_anywhere_give_a_place_that_has_them_or_nothing() -> None:
    forward = ordinary()
    rng = np.random.default_rng(3)
    px = np.concatenate(
        [
            rng.uniform((0, 0), (752, 480), (400, 2)),
            rng.uniform((-3000, -3000), (4000, 4000), (400, 2)),
            10.0 ** rng.uniform(3, 300, (100, 2)) * rng.choice([-1, 1], (100, 2)),
        ]
    )
    found, _, covariance = InverseMap(forward).to_mm(px)
    known = np.isfinite(found).all(axis=1)
    assert 100 < known.sum() < 500
    assert forward.to_px(found[known]) == pytest.approx(px[known], abs=1e-5)
    sigma_mm = np.sqrt(np.trace(covariance[known], axis1=1, axis2=2))
    assert (outside_mm(found[known]) <= 3 * sigma_mm + 1e-9).all()


@pytest.mark.parametrize("u", [math.nan, math.inf, -math.inf, 1e308])
def test_what_is_no_pixel_is_no_place(u: float) -> None:
    inverse = InverseMap(ordinary())
    with np.errstate(all="ignore"):
        found, _, _ = inverse.to_mm(np.array([[u, 240.0], [376.0, u], [u, u]]))
    assert np.isnan(found).all()


def test_a_folded_map_gives_no_number_from_beyond_its_fold() -> None:
    px = parabola(NODES) + np.random.default_rng(4).normal(0, 1e-3, NODES.shape)
    forward = fit_tensor_map(NODES, px, HULL, (3, 3)).map
    assert forward.folds
    inverse = InverseMap(forward)
    points = np.random.default_rng(5).uniform((-60, -48), (60, 48), (300, 2))
    found, _, _ = inverse.to_mm(parabola(points))
    known = np.isfinite(found).all(axis=1)
    assert (found[known, 0] < 20.1).all()  # the middle's side of the fold
    assert forward.to_px(found[known]) == pytest.approx(parabola(points)[known], abs=1e-5)
    beyond, _, _ = inverse.to_mm(np.array([[401.0, 240.0], [420.0, 200.0]]))
    assert np.isnan(beyond).all()  # u is 400 at most


def test_maps_of_nonsense_never_give_a_place_that_has_not_the_pixel() -> None:
    rng = np.random.default_rng(6)
    forward = ordinary()
    for scale in (1.0, 30.0, 1000.0):
        for _ in range(20):
            wild = replace(forward, spectra=forward.spectra + rng.normal(0, scale, forward.spectra.shape))
            px = rng.uniform((0, 0), (752, 480), (10, 2))
            found, _, _ = InverseMap(wild).to_mm(px)
            known = np.isfinite(found).all(axis=1)
            assert wild.to_px(found[known]) == pytest.approx(px[known], abs=1e-5)


@pytest.mark.parametrize("px", [(math.nan, 240.0), (376.0, math.nan), (math.inf, 240.0), (376.0, -math.inf)])
def test_what_is_not_a_number_is_at_no_place(px: tuple[float, float]) -> None:
    found, _, covariance = InverseMap(ordinary()).to_mm(np.array([px]))
    assert np.isnan(found).all()
    assert np.isnan(covariance).all()


def test_a_map_of_not_a_number_has_no_inverse() -> None:
    forward = ordinary()
    with pytest.raises(np.linalg.LinAlgError):
        InverseMap(replace(forward, spectra=forward.spectra * math.nan))


def test_a_map_that_overflows_gives_none() -> None:
    forward = ordinary()
    found, _, _ = InverseMap(replace(forward, spectra=forward.spectra * 1e150)).to_mm(
        np.array([[376.0, 240.0]])
    )
    assert np.isnan(found).all()


def test_a_flat_map_has_no_inverse() -> None:
    forward = ordinary()
    flat = forward.spectra.copy()
    flat[1] = flat[0]  # v = u: a line
    found, _, _ = InverseMap(replace(forward, spectra=flat)).to_mm(np.array([[376.0, 376.0]]))
    assert np.isnan(found).all()


def test_the_jacobian_is_the_derivative_of_the_map() -> None:
    forward = fit_lens_map(Nodes.ordinary(NODES, LENS(NODES)), HULL, (752, 480)).map
    points = np.random.default_rng(7).uniform((-60, -48), (60, 48), (50, 2))
    step = 1e-4
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        slope = (forward.to_px(points + shift) - forward.to_px(points - shift)) / (2 * step)
        assert forward.jacobian(points)[:, :, axis] == pytest.approx(slope, abs=1e-6)
    assert not forward.folds
