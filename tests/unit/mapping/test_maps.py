"""Maps of a target: at and between the nodes, and beyond them, where less and less is known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.gram import equidistant_nodes

from altd.mapping.grid import convex_hull_mm, edge_lines
from altd.mapping.inverse import InverseMap
from altd.mapping.polynomials import gram_basis
from altd.mapping.tensor_map import Fit, TensorMap, fit_tensor_map

CAMERA = np.array([[950.0, 0, 370.0], [0, 950.0, 245.0], [0, 0, 1]])
BROWN = np.array([-0.18, 0.05, 0.001, -0.002, 0.0])
TILT, SHIFT = np.array([0.15, -0.2, 0.02]), np.array([3.0, -2.0, 240.0])
NOISE_PX = 0.05


def lens(points_mm: np.ndarray) -> np.ndarray:
    """A tilted camera with a Brown lens, by OpenCV: mm on a plane → px."""
    space = np.column_stack([points_mm, np.zeros(len(points_mm))])
    return cv2.projectPoints(space, TILT, SHIFT, CAMERA, BROWN)[0].reshape(-1, 2)


def grid(columns: int = 6, rows: int = 5, pitch_mm: float = 25.0) -> np.ndarray:
    x = (np.arange(columns) - (columns - 1) / 2) * pitch_mm
    y = (np.arange(rows) - (rows - 1) / 2) * pitch_mm
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def fit(nodes_mm: np.ndarray, nodes_px: np.ndarray, degree: tuple[int, int] = (3, 3)) -> Fit:
    return fit_tensor_map(nodes_mm, nodes_px, convex_hull_mm(nodes_mm), degree)


def inside(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform((-60, -48), (60, 48), (count, 2))


def test_on_a_complete_grid_the_fit_is_the_projection_of_equation_3_35() -> None:
    rng = np.random.default_rng(1)
    nodes = grid()
    px = lens(nodes) + rng.normal(0, 1, (30, 2))
    bx = gram_basis(equidistant_nodes(6), 6, 3)
    by = gram_basis(equidistant_nodes(5), 5, 3)
    expected = by @ by.T @ px[:, 0].reshape(5, 6) @ bx @ bx.T
    result = fit(nodes, px)
    assert result.map.to_px(nodes)[:, 0].reshape(5, 6) == pytest.approx(expected, abs=1e-8)
    of_u = result.map.covariance_factor_px[0] / result.map.noise_px
    assert of_u @ of_u.T == pytest.approx(np.eye(16), abs=1e-9)


def test_a_polynomial_of_the_maps_degree_is_recovered_from_an_incomplete_grid() -> None:
    def polynomial(p: np.ndarray) -> np.ndarray:
        x, y = p[:, 0] / 60, p[:, 1] / 50
        return np.column_stack([400 + 300 * x - 20 * x**3 * y**2, 200 - 180 * y + 7 * x * y**3])

    nodes = np.delete(grid(), [7, 22], axis=0)
    points = inside(50, np.random.default_rng(2))
    assert fit(nodes, polynomial(nodes)).map.to_px(points) == pytest.approx(polynomial(points), abs=1e-6)


def test_the_inverse_finds_the_points_back_and_its_jacobian_is_the_derivative() -> None:
    rng = np.random.default_rng(3)
    nodes = grid()
    inverse = InverseMap(fit(nodes, lens(nodes)).map)
    points = inside(200, rng)
    px = inverse.forward.to_px(points)
    found, jacobian, _ = inverse.to_mm(px)
    assert found == pytest.approx(points, abs=1e-6)
    step = 1e-3
    for axis in range(2):
        shifted, _, _ = inverse.to_mm(px + step * np.eye(2)[axis])
        assert (shifted - found) / step == pytest.approx(jacobian[:, :, axis], abs=1e-4)


def test_a_point_outside_the_hull_is_nan_and_one_on_its_edge_is_not() -> None:
    nodes = grid()
    px = lens(nodes) + np.random.default_rng(5).normal(0, NOISE_PX, nodes.shape)
    inverse = InverseMap(fit(nodes, px).map)
    asked = np.array([[63.5, 0.0], [0.0, -51.0], [62.5, 50.0], [90.0, 90.0]])
    found, _, _ = inverse.to_mm(inverse.forward.to_px(asked))
    assert np.isfinite(found).all(axis=1).tolist() == [False, False, True, False]


def test_a_pixel_that_no_point_maps_to_is_nan() -> None:
    nodes = grid()
    inverse = InverseMap(fit(nodes, lens(nodes)).map)
    found, _, _ = inverse.to_mm(np.array([[1e5, -1e5], [np.nan, 100.0], [-3000.0, 4000.0]]))
    assert np.isnan(found).all()


def test_nodes_that_cannot_carry_a_map_are_refused() -> None:
    uneven = grid()
    uneven[uneven[:, 0] > 0, 0] += 10.0
    for nodes, message in (
        (grid(4, 4), "16 nodes are too few for degree 3 × 3, which has 16 coefficients"),
        (grid(3, 5), "a grid of 3 × 5 nodes is too small for a map"),
        (grid(1, 5), "all nodes have the same position; are the positions in mm"),
        (uneven, "steps from 25.000 to 35.000 mm are not equal"),
    ):
        with pytest.raises(ValueError, match=message):
            fit(nodes, lens(nodes))


def test_nodes_need_not_lie_exactly_where_they_were_meant_to() -> None:
    rng = np.random.default_rng(6)
    meant = grid()
    reached = meant + rng.normal(0, 0.02, meant.shape)
    inverse = InverseMap(fit(reached, lens(reached)).map)
    points = inside(50, rng)
    found, _, _ = inverse.to_mm(lens(points))
    exact, _, _ = InverseMap(fit(meant, lens(meant)).map).to_mm(lens(points))
    assert found == pytest.approx(exact, abs=1e-3)


def test_distances_to_the_hull_are_negative_inside() -> None:
    hull = convex_hull_mm(grid())
    points = np.array([[0.0, 0.0], [62.5, 0.0], [72.5, 0.0], [0.0, -53.0]])
    lines = edge_lines(hull)
    assert (points @ lines[:, :2].T - lines[:, 2]).max(axis=1) == pytest.approx([-50.0, 0.0, 10.0, 3.0])


NODES = np.stack(np.meshgrid(np.arange(-70.0, 71, 28), np.arange(-56.0, 57, 28)), -1).reshape(-1, 2)
PX_PER_MM = 4.0


def straight(**known: float) -> TensorMap:
    px = PX_PER_MM * NODES + (376.0, 240.0) + np.random.default_rng(1).normal(0, 0.04, NODES.shape)
    return replace(fit_tensor_map(NODES, px, convex_hull_mm(NODES), (1, 1)).map, **known)


def at(fitted: TensorMap, x_mm: float, y_mm: float) -> tuple[np.ndarray, np.ndarray]:
    mm, _, covariance = InverseMap(fitted).to_mm(fitted.to_px(np.array([[x_mm, y_mm]])))
    return mm[0], covariance[0]


def test_within_the_margin_a_point_is_known_and_beyond_it_not() -> None:
    fitted = straight(margin_mm=14.0)
    assert at(fitted, 83.9, 0.0)[0] == pytest.approx([83.9, 0.0], abs=1e-6)
    assert np.isnan(at(fitted, 84.3, 0.0)[0]).all()
    assert np.isnan(at(straight(), 83.9, 0.0)[0]).all()


def test_sigma_grows_by_what_the_model_is_off_for_each_millimetre_outside() -> None:
    sure, unsure = straight(margin_mm=14.0), straight(margin_mm=14.0, beyond_px_per_mm=0.03)
    for outside_mm in (0.0, 2.0, 5.0):
        place = 0.0, 56.0 + outside_mm
        added = at(unsure, *place)[1] - at(sure, *place)[1]
        assert added == pytest.approx(np.eye(2) * (0.03 * outside_mm / PX_PER_MM) ** 2, rel=0.02, abs=1e-7)


def test_a_point_known_worse_than_the_unit_must_be_is_not_known() -> None:
    """0.06 px for each mm are 0.05 mm after 3.3 mm at 4 px/mm."""
    fitted = straight(margin_mm=14.0, beyond_px_per_mm=0.06)
    assert not np.isnan(at(fitted, 73.0, 0.0)[0]).any()
    assert np.isnan(at(fitted, 73.5, 0.0)[0]).all()
    wildly_off = straight(margin_mm=14.0, beyond_px_per_mm=10.0)
    assert np.isnan(at(wildly_off, 72.0, 0.0)[0]).all(), "however large its sigma"
