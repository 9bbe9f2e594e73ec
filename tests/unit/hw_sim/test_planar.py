"""Settings of the simulated plate's camera."""

import numpy as np
import pytest

from hw_sim.planar import PlanarScene, places_mm

POSE = (0.0, 700.0, 0.0)


def test_a_finer_picture_has_the_same_view() -> None:
    usual, finer = PlanarScene(3), PlanarScene(3, size_px=(2048, 1536))
    at_mm = places_mm(usual.leds_mm, POSE)
    seen, seen_finer = (np.array(scene.lens.project(*at_mm.T)) for scene in (usual, finer))
    assert seen_finer + 0.5 == pytest.approx(2.0 * (seen + 0.5))
    assert finer.mean_electrons(POSE, (0,)).shape == (1536, 2048)


def test_a_camera_that_shakes_displaces_the_whole_picture_by_its_sigma() -> None:
    shake_px, frames = 1.5, 60
    scene = PlanarScene(3, size_px=(512, 384), shake_px=shake_px)
    lit, dark = (scene.mean_electrons(POSE, leds) for leds in ((4,), ()))
    v, u = np.indices(lit.shape)
    centres = []
    for _ in range(frames):
        light = np.maximum(scene.expose(lit).astype(float) - dark.max() / lit.max() * 255.0 - 20.0, 0.0)
        centres.append([(light * axis).sum() / light.sum() for axis in (u, v)])
    assert np.std(centres, axis=0) == pytest.approx([shake_px, shake_px], rel=0.3)
