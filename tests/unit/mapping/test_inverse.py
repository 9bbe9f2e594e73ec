"""The inverse gives no number for a pixel that no place inside the hull has; its sigma by Monte Carlo."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.lenses import SIZE, TABLE_3_2, grid, make_lens, seen

from altd.mapping.grid import convex_hull_mm, edge_lines
from altd.mapping.inverse import InverseMap
from altd.mapping.lens import fit_lens_map
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import Fit, TensorMap, fit_tensor_map

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


def test_a_map_that_overflows_and_a_flat_one_have_none() -> None:
    forward = ordinary()
    line = np.stack([forward.spectra[0]] * 2)  # v = u
    for spectra, px in ((forward.spectra * 1e150, [376.0, 240.0]), (line, [376.0, 376.0])):
        found, _, _ = InverseMap(replace(forward, spectra=spectra)).to_mm(np.array([px]))
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
        expected = one.noise_px**2 * np.array([1.8, 0.2])
        assert np.diag(shaped.noise_covariance_px2) == pytest.approx(expected, rel=0.02)
        found.append(one.to_px(middle)[0])
        predicted.append(shaped.variance_px2(middle)[0])
        _, jacobian, covariance = InverseMap(shaped).to_mm(one.to_px(middle))
        forward = np.linalg.inv(jacobian[0])
        of_place = forward @ covariance[0] @ forward.T - shaped.noise_covariance_px2
        assert np.diag(of_place) == pytest.approx(shaped.variance_px2(middle)[0], rel=1e-6)
    assert np.sqrt(np.mean(predicted, axis=0)) / np.std(found, axis=0) == pytest.approx(1.0, abs=0.3)
