"""Which model becomes the map, what its second map notices, and what it claims beyond the nodes.

Lenses of `hw_sim` are the truth; ``make bench-area`` measures the margin on pictures.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.cross_checked import difference_px, fitted_unit
from support.lenses import SIZE, TABLE_3_2, LensKind, grid, make_lens, seen

from altd.calibration.fitting import TargetFit, fit_nodes
from altd.mapping.grid import contains, convex_hull_mm
from altd.mapping.inverse import InverseMap
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import fit_tensor_map
from altd.records import FloatArray
from hw_sim.assembly import FRONT_FOCAL_MM, REAR_FOCAL_MM
from hw_sim.assembly import make_lens as assembled_lens
from hw_sim.lens import HEIGHT_PX, WIDTH_PX, Lens

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
    px = seen(make_lens(TABLE_3_2[1], rng), NODES, rng)
    fitted = fit_nodes(Nodes.ordinary(NODES, px), SIZE, MOST_DROPPED)
    tensors = {c.degree: c for c in fitted.candidates if c.model == "tensor"}
    assert set(tensors) == {(x, y) for x in range(1, 5) for y in range(1, 4)}  # nodes less two
    assert [c.model for c in fitted.candidates if c.degree is None] == ["lens", "fisheye"]
    assert all(min(c.map_sigma_px, c.gcv_px, c.leave_one_out_px) > 0 for c in fitted.candidates)
    assert fitted.cross_check.map.degree == min(tensors, key=lambda d: tensors[d].gcv_px)
    of_lenses = [c for c in fitted.candidates if c.degree is None]
    assert min(c.leave_one_out_px for c in of_lenses) == fitted.fit.leave_one_out_px
    (lens,) = (c for c in fitted.candidates if c.model == "lens")
    assert tensors[4, 3].map_sigma_px > 1.5 * lens.map_sigma_px


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


WRONG_MM = 0.3


@pytest.mark.parametrize("kind", TABLE_3_2, ids=str)
def test_a_map_that_is_wrong_by_0_3_mm_is_noticed(kind: LensKind) -> None:
    for seed in range(3):
        fitted, rng = fitted_unit(kind, seed)
        points = rng.uniform((-60, -48), (60, 48), (100, 2))
        forward = fitted.fit.map
        scale_px_mm = np.sqrt(np.abs(np.linalg.det(forward.jacobian(points))).mean())
        spectra = forward.spectra.copy()
        nodes = forward.x_axis.nodes * forward.y_axis.nodes
        spectra[seed % 2, 0, 0] += WRONG_MM * scale_px_mm * np.sqrt(nodes)  # a shift: the constant term
        off_px = difference_px(fitted, replace(forward, spectra=spectra), points)
        assert (off_px > fitted.cross_check.limit_px).all()


def test_a_wrong_bend_is_noticed_where_it_is_wrong() -> None:
    fitted, rng = fitted_unit(TABLE_3_2[1], 1)
    points = rng.uniform((-60, -48), (60, 48), (300, 2))
    forward = fitted.fit.map
    spectra = forward.spectra.copy()
    spectra[0, 1, 2] += 20.0
    wrong = replace(forward, spectra=spectra)
    off_px = np.linalg.norm(wrong.to_px(points) - forward.to_px(points), axis=1)
    noticed = difference_px(fitted, wrong, points) > fitted.cross_check.limit_px
    assert noticed[off_px > 2 * fitted.cross_check.limit_px].all()
    assert not noticed[off_px < 0.3 * fitted.cross_check.limit_px].any()
    assert 0 < noticed.sum() < len(points)


NODES_MM = np.stack(np.meshgrid(np.arange(-62.5, 63, 25), np.arange(-50.0, 51, 25)), -1).reshape(-1, 2)
PATTERN_PX = 0.04
"""Scatter of a node about the map, print and speckle."""


def noisy(lens: Lens, places_mm: FloatArray, rng: np.random.Generator) -> FloatArray:
    return np.stack(lens.project(*places_mm.T), axis=1) + rng.normal(0, PATTERN_PX, places_mm.shape)


def rippled(px: FloatArray, places_mm: FloatArray) -> FloatArray:
    """Waves of 0.5 px and 150 mm: a window that no lens model describes."""
    return px + 0.5 * np.sin(2 * np.pi * places_mm / 150.0 + 0.7)


def fitted(px: FloatArray, sigma: FloatArray | None = None) -> TargetFit:
    nodes = Nodes.ordinary(NODES_MM, px) if sigma is None else Nodes(NODES_MM, px, sigma)
    return fit_nodes(nodes, (WIDTH_PX, HEIGHT_PX), 0)


def around(rng: np.random.Generator, count: int) -> FloatArray:
    """Places up to half a pitch outside of the nodes."""
    places = rng.uniform(-1.0, 1.0, (8 * count, 2)) * (75.0, 62.5)
    return places[(np.abs(places) > (62.5, 50.0)).any(axis=1)][:count]


@pytest.mark.long
def test_half_a_pitch_outside_of_the_nodes_errors_are_what_sigma_says() -> None:
    normalised, known = [], 0
    for seed in range(8):
        rng = np.random.default_rng([seed, 7])
        lens = assembled_lens((FRONT_FOCAL_MM, REAR_FOCAL_MM)[seed % 2], seed % 2 == 0, rng)
        made = fitted(noisy(lens, NODES_MM, rng))
        places = around(rng, 60)
        mm, _, covariance = InverseMap(made.fit.map).to_mm(noisy(lens, places, rng))
        sigma_mm = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        good = ~np.isnan(mm[:, 0])
        known += int(good.sum())
        normalised.append(((mm - places) / sigma_mm)[good])
    assert known >= 0.98 * 8 * 60
    assert 0.8 < np.sqrt(np.mean(np.square(np.concatenate(normalised)))) < 1.25


@pytest.mark.long
def test_where_no_model_fits_nothing_wrong_is_called_known() -> None:
    errors, sigmas, known = [], [], 0
    for seed in range(6):
        rng = np.random.default_rng([seed, 7])
        lens = assembled_lens(REAR_FOCAL_MM, False, rng)
        made = fitted(rippled(noisy(lens, NODES_MM, rng), NODES_MM))
        places = around(rng, 60)
        mm, _, covariance = InverseMap(made.fit.map).to_mm(rippled(noisy(lens, places, rng), places))
        good = ~np.isnan(mm[:, 0])
        known += int(good.sum())
        errors.append((mm - places)[good])
        sigmas.append(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))[good])
        assert made.fit.map.beyond_px_per_mm > 0.01
    error_mm, sigma_mm = np.abs(np.concatenate(errors)), np.concatenate(sigmas)
    assert 0 < known < 0.9 * 6 * 60
    assert not np.any((error_mm > 5 * sigma_mm) & (error_mm > 0.05))


def test_the_margin_is_half_a_pitch() -> None:
    rng = np.random.default_rng(1)
    made = fitted(noisy(assembled_lens(REAR_FOCAL_MM, False, rng), NODES_MM, rng))
    assert made.fit.map.margin_mm == made.cross_check.map.margin_mm == pytest.approx(12.5)


def test_a_node_that_is_known_worse_moves_the_map_less() -> None:
    """A top row whose spots the picture cuts, ten times as uncertain as the others."""
    rng = np.random.default_rng(3)
    lens = assembled_lens(REAR_FOCAL_MM, False, rng)
    px, top = noisy(lens, NODES_MM, rng), NODES_MM[:, 1] > 49
    px[top] += rng.normal(0, 10 * PATTERN_PX, (int(top.sum()), 2))
    truth = np.stack(lens.project(*NODES_MM.T), axis=1)
    sigma = np.where(top, 10.0, 1.0)
    equal, weighed = (made.fit.map.to_px(NODES_MM) - truth for made in (fitted(px), fitted(px, sigma)))
    assert np.sqrt(np.mean(np.square(weighed))) < 0.6 * np.sqrt(np.mean(np.square(equal)))
    assert fitted(px, sigma).fit.map.noise_px == pytest.approx(PATTERN_PX, rel=0.35)
