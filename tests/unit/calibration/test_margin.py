"""Claims beyond the nodes, against lenses of hw_sim; ``make bench-area`` measures them on pictures."""

from __future__ import annotations

import numpy as np
import pytest

from altd.calibration.fitting import TargetFit, fit_nodes
from altd.mapping.inverse import InverseMap
from altd.mapping.nodes import Nodes
from altd.records import FloatArray
from hw_sim.assembly import FRONT_FOCAL_MM, REAR_FOCAL_MM, make_lens
from hw_sim.lens import HEIGHT_PX, WIDTH_PX, Lens

NODES = np.stack(np.meshgrid(np.arange(-62.5, 63, 25), np.arange(-50.0, 51, 25)), -1).reshape(-1, 2)
PATTERN_PX = 0.04
"""Scatter of a node about the map, print and speckle."""


def seen(lens: Lens, places_mm: FloatArray, rng: np.random.Generator) -> FloatArray:
    return np.stack(lens.project(*places_mm.T), axis=1) + rng.normal(0, PATTERN_PX, places_mm.shape)


def rippled(px: FloatArray, places_mm: FloatArray) -> FloatArray:
    """Waves of 0.5 px and 150 mm: a window that no lens model describes."""
    return px + 0.5 * np.sin(2 * np.pi * places_mm / 150.0 + 0.7)


def fitted(px: FloatArray, sigma: FloatArray | None = None) -> TargetFit:
    nodes = Nodes.ordinary(NODES, px) if sigma is None else Nodes(NODES, px, sigma)
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
        lens = make_lens((FRONT_FOCAL_MM, REAR_FOCAL_MM)[seed % 2], seed % 2 == 0, rng)
        made = fitted(seen(lens, NODES, rng))
        places = around(rng, 60)
        mm, _, covariance = InverseMap(made.fit.map).to_mm(seen(lens, places, rng))
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
        lens = make_lens(REAR_FOCAL_MM, False, rng)
        made = fitted(rippled(seen(lens, NODES, rng), NODES))
        places = around(rng, 60)
        mm, _, covariance = InverseMap(made.fit.map).to_mm(rippled(seen(lens, places, rng), places))
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
    made = fitted(seen(make_lens(REAR_FOCAL_MM, False, rng), NODES, rng))
    assert made.fit.map.margin_mm == made.cross_check.map.margin_mm == pytest.approx(12.5)


def test_a_node_that_is_known_worse_moves_the_map_less() -> None:
    """A top row whose spots the picture cuts, ten times as uncertain as the others."""
    rng = np.random.default_rng(3)
    lens = make_lens(REAR_FOCAL_MM, False, rng)
    px, top = seen(lens, NODES, rng), NODES[:, 1] > 49
    px[top] += rng.normal(0, 10 * PATTERN_PX, (int(top.sum()), 2))
    truth = np.stack(lens.project(*NODES.T), axis=1)
    sigma = np.where(top, 10.0, 1.0)
    equal, weighed = (made.fit.map.to_px(NODES) - truth for made in (fitted(px), fitted(px, sigma)))
    assert np.sqrt(np.mean(np.square(weighed))) < 0.6 * np.sqrt(np.mean(np.square(equal)))
    assert fitted(px, sigma).fit.map.noise_px == pytest.approx(PATTERN_PX, rel=0.35)
