"""The second map: silent on good units, and not when either map is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.lenses import SIZE, TABLE_3_2, LensKind, grid, make_lens, seen

from altd.calibration.fitting import TargetFit, fit_nodes
from altd.mapping.tensor_map import TensorMap

NODES = grid()
WRONG_MM = 0.3


def fitted_unit(kind: LensKind, seed: int) -> tuple[TargetFit, np.random.Generator]:
    rng = np.random.default_rng([seed, round(kind.focal_mm * 10)])
    return fit_nodes(NODES, seen(make_lens(kind, rng), NODES, rng), SIZE, None, 0), rng


def apart_px(fitted: TargetFit, wrong: TensorMap, points_mm: np.ndarray) -> np.ndarray:
    px = wrong.to_px(points_mm)
    return np.array(
        [fitted.cross_check.apart_px(x, y, u, v) for (x, y), (u, v) in zip(points_mm, px, strict=True)]
    )


@pytest.mark.parametrize("kind", TABLE_3_2, ids=str)
def test_on_good_units_the_maps_agree_everywhere(kind: LensKind) -> None:
    for seed in range(6):
        fitted, rng = fitted_unit(kind, seed)
        points = rng.uniform((-62.5, -50), (62.5, 50), (300, 2))
        apart = apart_px(fitted, fitted.fit.map, points)
        assert apart.max() < 0.7 * fitted.cross_check.bound_px
        assert apart.max() <= fitted.cross_check.largest_px * 1.1
        assert fitted.cross_check.largest_px <= apart.max() * 2


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
        assert (
            apart_px(fitted, replace(forward, spectra=spectra), points) > fitted.cross_check.bound_px
        ).all()


def test_a_wrong_bend_is_noticed_where_it_is_wrong() -> None:
    fitted, rng = fitted_unit(TABLE_3_2[1], 1)
    points = rng.uniform((-60, -48), (60, 48), (300, 2))
    forward = fitted.fit.map
    spectra = forward.spectra.copy()
    spectra[0, 1, 2] += 20.0
    wrong = replace(forward, spectra=spectra)
    off_px = np.linalg.norm(wrong.to_px(points) - forward.to_px(points), axis=1)
    noticed = apart_px(fitted, wrong, points) > fitted.cross_check.bound_px
    assert noticed[off_px > 2 * fitted.cross_check.bound_px].all()
    assert not noticed[off_px < 0.3 * fitted.cross_check.bound_px].any()
    assert 0 < noticed.sum() < len(points)
