"""Prints of many lattices before a simulated camera, and the sums that a series is fitted by."""

import numpy as np
import pytest
from support.prints import NODES_MM, Dots, Scene, lattice_of, steps

from altd.calibration.printed.find import Print, Series, find_print
from altd.calibration.printed.lattice import Lattice
from altd.calibration.printed.sample import NodePixels
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


def whole(lattice: Lattice, steps_mm: np.ndarray) -> np.ndarray:
    """The distance of the phases that a print's steps turn through from whole turns, radians."""
    turns = steps_mm @ lattice.reciprocal.T / (2 * np.pi)
    assert abs(np.linalg.det(turns)) == pytest.approx(
        1, abs=0.01
    )  # the lattice itself, no coarser or finer one
    return 2 * np.pi * np.abs(turns - np.rint(turns))


@pytest.mark.parametrize(
    ("pitch_mm", "angle_deg", "turn_deg", "ratio", "radius_mm"),
    [
        (0.8, 60, -1.9, 1.0, 0.20),
        (2.0, 60, 17.0, 1.0, 0.50),
        (1.0, 90, 0.5, 1.0, 0.25),
        (1.0, 90, 31.0, 1.7, 0.30),
    ],
)
def test_lattices_of_many_kinds_are_found(
    pitch_mm: float, angle_deg: float, turn_deg: float, ratio: float, radius_mm: float
) -> None:
    steps_mm = steps(pitch_mm, angle_deg, turn_deg, ratio)
    lattice = lattice_of(Scene(Dots(steps_mm, radius_mm), power_mw=2.5))
    assert lattice is not None
    assert lattice.pitch_mm == pytest.approx(pitch_mm, rel=1e-3)
    assert whole(lattice, steps_mm).max() < 0.003


PX_PER_MM = 5.0
BLUR_PX = 0.5
RIDGE = 1e-6


def samples(lattice: Lattice, truth: np.ndarray, noise: float) -> list[NodePixels]:
    """Spots of 12 mm on a grid of 6 × 5 whose light follows a series; the scale falls over the picture."""
    rng = np.random.default_rng(3)
    disc = np.stack(np.meshgrid(*[np.arange(-6, 6, 1 / PX_PER_MM)] * 2), axis=-1).reshape(-1, 2)
    disc = disc[np.hypot(*disc.T) < 6]
    seen = []
    for x_mm in np.linspace(-70, 70, 6):
        for y_mm in np.linspace(-56, 56, 5):
            mm = np.array([x_mm, y_mm]) + disc * (1 + 1e-3 * x_mm) + rng.uniform(-0.1, 0.1, 2)
            metric = np.diag([(1 + 1e-3 * x_mm) ** 2, 1.0]) / PX_PER_MM**2
            ratio = design(lattice, mm, metric, BLUR_PX) @ truth + noise * rng.normal(size=len(mm))
            seen.append(NodePixels(mm, ratio, rng.uniform(10, 44, len(mm)), metric))
    return seen


def design(lattice: Lattice, mm: np.ndarray, metric: np.ndarray, blur_px: float) -> np.ndarray:
    """Columns 1, cos, −sin of each harmonic, as weak as a Gaussian blur of the picture makes it."""
    phases = mm @ lattice.vectors.T
    squared = np.minimum(np.einsum("hi,ij,hj->h", lattice.vectors, metric, lattice.vectors), 40.0)
    weaker = np.exp(-0.5 * blur_px**2 * squared)
    return np.column_stack([np.ones(len(mm)), weaker * np.cos(phases), -weaker * np.sin(phases)])


@pytest.mark.parametrize("pitch_mm", [0.6, 1.0, 3.0])
def test_it_is_the_least_squares_solution_of_all_pixels(pitch_mm: float) -> None:
    lattice = Lattice(2 * np.pi * np.linalg.inv(steps(pitch_mm, 60, 1.3)).T)
    size = 1 + 2 * len(lattice.vectors)
    truth = np.random.default_rng(1).normal(0, 0.1, size)
    truth[0] = 1.0
    seen = samples(lattice, truth, noise=0.05)
    series = Series.fit(lattice, iter(seen), (0.3, BLUR_PX, 0.9))
    assert series.blur_px == BLUR_PX

    whole = np.concatenate([design(lattice, s.mm, s.metric, BLUR_PX) for s in seen])
    root = np.sqrt(np.concatenate([s.weight for s in seen]))
    light = np.concatenate([s.ratio for s in seen])
    ridged = np.vstack([whole * root[:, None], np.sqrt(RIDGE) * np.eye(size)])
    expected = np.linalg.lstsq(ridged, np.concatenate([light * root, np.zeros(size)]), rcond=None)[0]

    found = np.concatenate([[series.mean], series.amplitudes.real, series.amplitudes.imag])
    # the part of a wave in the picture: the blur leaves almost nothing of some
    reaching = np.sqrt(np.square(whole).mean(axis=0))
    assert np.abs((found - expected) * reaching).max() < 1e-12


def test_large_spots_go_in_by_parts() -> None:
    """Of 100,000 pixels, as one of 35 mm before a camera of 10 px/mm has."""
    lattice = Lattice(2 * np.pi * np.linalg.inv(steps(1.0, 60, 1.3)).T)
    fundamental = np.abs(lattice.harmonics).sum(axis=1) == 1
    truth = np.concatenate([[1.0], 0.2 * fundamental, 0.1 * fundamental])
    mm = np.random.default_rng(2).uniform(-17, 17, (100_000, 2))
    metric = np.eye(2) / 100.0
    ratio = design(lattice, mm, metric, BLUR_PX) @ truth
    whole = NodePixels(mm, ratio, np.ones(len(mm)), metric)
    parts = list(whole.parts())
    assert len(parts) > 10
    assert np.array_equal(np.concatenate([part.ratio for part in parts]), ratio)
    series = Series.fit(lattice, [whole], (BLUR_PX,))
    found = np.concatenate([[series.mean], series.amplitudes.real, series.amplitudes.imag])
    assert found == pytest.approx(truth, abs=1e-7)
    shift_mm = np.array([0.003, -0.002])
    aside = NodePixels(mm - shift_mm, ratio, np.ones(len(mm)), metric)
    assert series.offset_mm(aside) == pytest.approx(shift_mm, abs=2e-5)
