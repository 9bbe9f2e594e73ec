"""Units for the simulator's tests, and the foreign tool that knows what a camera should see."""

from collections.abc import Callable, Iterator

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from hw_sim.beam import BeamPose
from hw_sim.lens import PIXEL_MM, Lens
from hw_sim.unit import CAMERAS, EXPOSURES_MS, Unit, UnitConfig

Projection = Callable[[Lens, npt.ArrayLike], npt.NDArray[np.float64]]


@pytest.fixture(scope="session")
def ordinary_unit() -> Unit:
    return Unit(UnitConfig(seed=5, fps=50.0))


@pytest.fixture
def unit(ordinary_unit: Unit) -> Iterator[Unit]:
    """An ordinary unit with the beam in the middle, as it was made (half a second of work, so shared)."""
    _restore(ordinary_unit)
    yield ordinary_unit
    _restore(ordinary_unit)


def _restore(unit: Unit) -> None:
    """Undo what other tests of this process did to it, in whatever order they came."""
    unit.clear()
    unit.leds_on = False
    unit.even_mw_per_mm2 = 0.0
    unit.place(BeamPose(0.0, 0.0))
    for camera in CAMERAS:
        unit.set_camera(camera, exposure_ms=EXPOSURES_MS[camera], gain=1.0)


@pytest.fixture(scope="session")
def clean_unit() -> Unit:
    """No speckle, no stray light, no hot pixels, 16 bits: what is left is geometry and noise."""
    return Unit(UnitConfig(seed=7, speckle_contrast=0.0, lux=0.0, hot_pixels=0, bits=16))


@pytest.fixture(scope="session")
def opencv_project() -> Projection:
    """Pixels (n, 2) of target points (n, 2) in mm, by cv2.projectPoints."""

    def project(lens: Lens, points_mm: npt.ArrayLike) -> npt.NDArray[np.float64]:
        x_mm, y_mm = np.asarray(points_mm, dtype=np.float64).reshape(-1, 2).T
        face = np.column_stack([-x_mm if lens.mirrored else x_mm, -y_mm, np.zeros_like(x_mm)])
        focal_px = lens.focal_mm / PIXEL_MM
        u0, v0 = lens.principal_px
        matrix = np.array([[focal_px, 0.0, u0], [0.0, focal_px, v0], [0.0, 0.0, 1.0]])
        turn, _ = cv2.Rodrigues(lens.rotation)
        pixels, _ = cv2.projectPoints(face, turn, lens.translation_mm, matrix, np.array(lens.distortion))
        return np.asarray(pixels.reshape(-1, 2), dtype=np.float64)

    return project
