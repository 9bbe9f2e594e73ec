"""The second map is not silent when either map is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.cross_checked import difference_px, fitted_unit
from support.lenses import TABLE_3_2, LensKind

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
        assert (
            difference_px(fitted, replace(forward, spectra=spectra), points) > fitted.cross_check.limit_px
        ).all()


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
