import numpy as np
import pytest
from support.prints import NODES_MM, Dots, Scene, steps

from altd.calibration.printed.find import Print, find_print
from altd.mapping.grid import convex_hull_mm
from altd.mapping.lens import fit_lens_map
from altd.mapping.nodes import Nodes
from altd.vision.settings import SpotSettings
from hw_sim.lens import HEIGHT_PX, WIDTH_PX


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(Dots(steps(1.0, 60, 1.3), 0.25), power_mw=2.5)


@pytest.fixture(scope="module")
def found(scene: Scene) -> Print:
    """Through a map that is off by some 0.02 mm, as the first one of a scan is."""
    rng = np.random.default_rng(1)
    rough_px = scene.nodes_px() + rng.normal(0, 0.06, (len(NODES_MM), 2))
    first_map = fit_lens_map(
        Nodes.ordinary(NODES_MM, rough_px), convex_hull_mm(NODES_MM), (WIDTH_PX, HEIGHT_PX)
    ).map
    found = find_print(scene.frames().__getitem__, scene.nodes_px(), first_map, SpotSettings())
    assert found is not None
    return found


def test_the_pitch_is_found_to_a_thousandth(found: Print) -> None:
    assert found.lattice.pitch_mm == pytest.approx(1.0, rel=1e-3)


def test_the_flat_is_what_the_pixels_show_of_even_light(found: Print, scene: Scene) -> None:
    view = scene.view
    inside = (np.abs(view.x_mm) < 62) & (np.abs(view.y_mm) < 49)
    falloff = scene.lens.relative_illumination(view.x_mm, view.y_mm)  # no spot shows it to a print's model
    assert found.flat.source == "print"
    assert np.corrcoef(found.flat.response[inside], (view.response / falloff)[inside])[0, 1] > 0.97


def test_the_marks_are_the_regular_places_of_the_nodes(found: Print, scene: Scene) -> None:
    """The places that their pixels really see, but for an affine map."""
    true_mm = np.stack(scene.lens.unproject(*found.fiducials.px.T), axis=1)
    design = np.column_stack([np.ones(len(true_mm)), found.fiducials.regular_mm])
    off_mm = true_mm - design @ np.linalg.lstsq(design, true_mm, rcond=None)[0]
    rms_mm = float(np.sqrt(np.square(off_mm).sum() / (2 * len(true_mm) - 6)))
    assert rms_mm < 0.002  # a hundredth of a pixel
    assert rms_mm < 1.3 * found.fiducials.sigma_mm < 0.01


def test_print_at_a_few_nodes_is_no_print(scene: Scene) -> None:
    plain = Scene(None, power_mw=2.0)
    frames = [*scene.frames()[:10], *plain.frames()[10:]]
    assert find_print(frames.__getitem__, scene.nodes_px(), scene.first_map(), SpotSettings()) is None


def test_too_few_spots_show_no_print(scene: Scene) -> None:
    frames = scene.frames()[:11]
    assert find_print(frames.__getitem__, scene.nodes_px()[:11], scene.first_map(), SpotSettings()) is None
