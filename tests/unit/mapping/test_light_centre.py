"""The shift of a patch's centre of light, against outlines that OpenCV projects point by point."""

from __future__ import annotations

import numpy as np
import pytest
from support.plates import View, grid_mm, tilted

from altd.mapping.camera_model import disc_moment_mm2, light_centre_shift_px, spot_moment_mm2

VIEWS = {
    "ordinary": View(1333.0, 400.0, tilted(12.0, 1.0)),
    "tilted": View(950.0, 330.0, tilted(30.0, 2.5), mirrored=True),
    "fisheye": View(600.0, 150.0, tilted(30.0, 0.4), (-0.02, 0.0, 0.0, 0.0), fisheye=True),
}


def centre_of_area(outline: np.ndarray) -> np.ndarray:
    """Green's theorem for a polygon (n, 2)."""
    (x, y), (x2, y2) = outline.T, np.roll(outline, -1, axis=0).T
    cross = x * y2 - x2 * y
    return np.array([((x + x2) * cross).sum(), ((y + y2) * cross).sum()]) / (3 * cross.sum())


@pytest.mark.parametrize("name", VIEWS)
def test_the_shift_of_a_discs_centre_is_what_its_projected_outline_shows(name: str) -> None:
    view, around = VIEWS[name], np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    places = grid_mm().reshape(-1, 2)
    rim_mm = 2.5 * np.column_stack([np.cos(around), np.sin(around)])
    centres = np.array([view.to_px(place)[0] for place in places])
    true = np.array(
        [centre_of_area(view.to_px(place + rim_mm) - at) for place, at in zip(places, centres, strict=True)]
    )
    shift = light_centre_shift_px(view.to_px, places, disc_moment_mm2(5.0))
    assert np.abs(true).max() > 0.01  # else this would test nothing
    assert np.abs(shift - true).max() < 0.02 * np.abs(true).max()


def test_a_gaussian_spots_moment_is_what_its_weights_have() -> None:
    x, y = np.meshgrid(np.linspace(-12, 12, 1201), np.linspace(-12, 12, 1201))
    light = np.exp(-8 * (x**2 + y**2) / 12.0**2)
    for threshold, power in ((0.07, 0.4), (0.2, 1.0)):
        weight = np.maximum(light - threshold, 0) ** power
        assert spot_moment_mm2(12.0, threshold, power) == pytest.approx(
            (weight * x**2).sum() / weight.sum(), rel=1e-3
        )
    assert spot_moment_mm2(0.0, 0.07, 0.4) == 0
