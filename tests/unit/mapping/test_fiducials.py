"""Marks of a print before a lens of the simulator, and the shift of a patch's centre of light."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from support.plates import View, grid_mm, tilted

from altd.mapping.camera_model import CameraModel, disc_moment_mm2, light_centre_shift_px, spot_moment_mm2
from altd.mapping.grid import convex_hull_mm
from altd.mapping.lens import fit_lens_map
from altd.mapping.nodes import Fiducials, Nodes
from hw_sim.assembly import FRONT_FOCAL_MM, make_lens
from hw_sim.lens import HEIGHT_PX, WIDTH_PX, Lens
from hw_sim.scan import Grid

NODES_MM = np.array(Grid().nodes_mm())
PLACES_MM = np.stack(np.meshgrid(np.linspace(-60, 60, 9), np.linspace(-48, 48, 8)), axis=-1).reshape(-1, 2)
TURN = np.array([[1.02, 0.03], [-0.05, 0.97]])


def seen(lens: Lens, mm: np.ndarray) -> np.ndarray:
    return np.stack(lens.project(*mm.T), axis=1)


def camera(seed: int = 1) -> CameraModel:
    rng = np.random.default_rng(seed)
    parameters = np.zeros(CameraModel.optical_parameters("brown"))
    parameters[:3] = rng.normal(0, 0.1, 3)
    parameters[5] = np.log(4.5)
    return CameraModel("brown", parameters, True, WIDTH_PX, HEIGHT_PX)


def test_marks_that_lie_as_the_camera_sees_them_are_satisfied_however_the_print_is_laid() -> None:
    at = camera()
    fiducials = Fiducials(at.to_px(NODES_MM), NODES_MM, 0.001)
    assert np.abs(fiducials.deviations(at)).max() < 1e-5
    # a print that is turned, stretched and moved needs the places it was affinely made of
    laid = Fiducials(at.to_px(NODES_MM), NODES_MM @ TURN.T + (0.3, -0.2), 0.001)
    assert np.abs(laid.deviations(at)).max() < 1e-3


def test_a_mark_that_is_off_counts_in_units_of_sigma() -> None:
    at = camera()
    off = NODES_MM.copy()
    off[14, 0] += 0.01
    misfit = Fiducials(at.to_px(NODES_MM), off, 0.002).deviations(at).reshape(2, -1)
    assert np.abs(misfit[0, 14]) == pytest.approx(5.0, rel=0.1)
    assert np.abs(misfit[1]).max() < 0.01


def test_the_slopes_are_the_derivatives() -> None:
    at = camera()
    fiducials = Fiducials(at.to_px(NODES_MM), NODES_MM, 0.001)
    slopes = fiducials.slopes(at)
    assert slopes.shape == (2 * len(NODES_MM), len(at.parameters))
    for index in range(len(at.parameters)):
        step = np.zeros(len(at.parameters))
        step[index] = 1e-4
        ends = [fiducials.deviations(replace(at, parameters=at.parameters + sign * step)) for sign in (1, -1)]
        by_difference = (ends[0] - ends[1]) / 2e-4
        assert slopes[:, index] == pytest.approx(by_difference, abs=0.02 * np.abs(by_difference).max() + 1e-2)


def test_marks_make_a_map_between_noisy_nodes_better() -> None:
    misses: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(8):
        rng = np.random.default_rng(seed)
        lens = make_lens(FRONT_FOCAL_MM, mirrored=True, rng=rng)
        nodes_px = seen(lens, NODES_MM) + rng.normal(0, 0.05, NODES_MM.shape)
        regular_mm = NODES_MM @ TURN.T + (5.0, -3.0) + rng.normal(0, 0.003, NODES_MM.shape)
        fiducials = Fiducials(seen(lens, NODES_MM), regular_mm, 0.003)
        for given in (None, fiducials):
            fit = fit_lens_map(
                Nodes.ordinary(NODES_MM, nodes_px),
                convex_hull_mm(NODES_MM),
                (WIDTH_PX, HEIGHT_PX),
                fiducials=given,
            )
            off_px = fit.map.to_px(PLACES_MM) - seen(lens, PLACES_MM)
            misses[given is not None].append(float(np.square(off_px).mean()))
    alone_px, guided_px = (np.sqrt(np.mean(misses[guided])) for guided in (False, True))
    assert 0.01 < alone_px < 0.04
    assert guided_px < 0.8 * alone_px


def test_a_fit_through_two_thousand_nodes_and_marks_takes_memory_in_proportion() -> None:
    """A matrix of all nodes by all would be 128 MB, and the map must not be another one for lack of it."""
    rng = np.random.default_rng(4)
    lens = make_lens(FRONT_FOCAL_MM, mirrored=True, rng=rng)
    nodes_mm = np.array(Grid(2.8, 50, 40).nodes_mm())
    nodes_px = seen(lens, nodes_mm) + rng.normal(0, 0.03, nodes_mm.shape)
    fiducials = Fiducials(nodes_px, nodes_mm + rng.normal(0, 0.003, nodes_mm.shape), 0.003)
    tracemalloc.start()
    try:
        fit = fit_lens_map(
            Nodes.ordinary(nodes_mm, nodes_px),
            convex_hull_mm(nodes_mm),
            (WIDTH_PX, HEIGHT_PX),
            fiducials=fiducials,
        )
        assert tracemalloc.get_traced_memory()[1] < 30e6
    finally:
        tracemalloc.stop()
    assert 0 < fit.effective_parameters < fit.parameters == 13
    assert fit.leave_one_out_px == pytest.approx(0.03, rel=0.05)
    dense_mm = fit.map.dense_mm()
    assert np.abs(fit.map.to_px(dense_mm) - seen(lens, dense_mm)).max() < 0.02


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
    rims = (view.to_px(place + rim_mm) - at for place, at in zip(places, centres, strict=True))
    true = np.array([centre_of_area(rim) for rim in rims])
    shift = light_centre_shift_px(view.to_px, places, disc_moment_mm2(5.0))
    assert np.abs(true).max() > 0.01  # else this would test nothing
    assert np.abs(shift - true).max() < 0.02 * np.abs(true).max()


def test_a_gaussian_spots_moment_is_what_its_weights_have() -> None:
    x, y = np.meshgrid(np.linspace(-12, 12, 1201), np.linspace(-12, 12, 1201))
    light = np.exp(-8 * (x**2 + y**2) / 12.0**2)
    for threshold, power in ((0.07, 0.4), (0.2, 1.0)):
        weight = np.maximum(light - threshold, 0) ** power
        expected = (weight * x**2).sum() / weight.sum()
        assert spot_moment_mm2(12.0, threshold, power) == pytest.approx(expected, rel=1e-3)
    assert spot_moment_mm2(0.0, 0.07, 0.4) == 0
