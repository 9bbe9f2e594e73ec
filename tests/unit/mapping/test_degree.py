"""The degree of the tensor polynomial against the truth that it does not know, its basis, and its grid."""

import numpy as np
import pytest
from support.gram import equidistant_nodes
from support.lenses import TABLE_3_2, LensKind, grid, make_lens, seen

from altd.mapping.grid import Axis, Cell, GridPart, convex_hull_mm
from altd.mapping.polynomials import gram_basis, gram_powers
from altd.mapping.tensor_map import Fit, fit_tensor_map, fit_tensor_maps

NODES = grid(7, 5)
HULL = convex_hull_mm(NODES)


def polynomial(p: np.ndarray) -> np.ndarray:
    """Of degree 4 along x and 2 along y."""
    x, y = p[:, 0] / 75, p[:, 1] / 50
    return np.column_stack([376 + 300 * x + 3 * x**4 - 2 * x * y**2, 240 - 200 * y + 2 * x**4 * y**2])


def miss(fit: Fit, points: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean((fit.map.to_px(points) - truth) ** 2)))


def test_the_score_is_that_of_its_formula() -> None:
    px = polynomial(NODES) + np.random.default_rng(1).normal(0, 0.05, NODES.shape)
    for fit in fit_tensor_maps(NODES, px, HULL):
        coefficients = (fit.degree[0] + 1) * (fit.degree[1] + 1)
        squares = np.square(px - fit.map.to_px(NODES)).sum()
        expected = np.sqrt(squares / 70) / (1 - coefficients / 35)
        assert fit.gcv_px == pytest.approx(expected)
        assert fit.parameters == 2 * coefficients


def test_the_degree_of_a_polynomial_is_found() -> None:
    rng = np.random.default_rng(2)
    noisy = (polynomial(NODES) + rng.normal(0, 0.05, NODES.shape) for _ in range(40))
    found = [fit_tensor_map(NODES, px, HULL).degree for px in noisy]
    assert all(degree is not None and degree[0] >= 4 and degree[1] >= 2 for degree in found)
    assert found.count((4, 2)) > 25


@pytest.mark.parametrize("kind", TABLE_3_2, ids=str)
def test_the_chosen_degree_is_nearly_as_good_as_the_best(kind: LensKind) -> None:
    chosen, best, fixed = [], [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        lens = make_lens(kind, rng)
        px = seen(lens, NODES, rng)
        points = rng.uniform((-75, -50), (75, 50), (200, 2))
        truth = lens(points)
        chosen.append(miss(fit_tensor_map(NODES, px, HULL), points, truth))
        best.append(min(miss(fit, points, truth) for fit in fit_tensor_maps(NODES, px, HULL)))
        fixed.append(miss(fit_tensor_map(NODES, px, HULL, (3, 3)), points, truth))
    assert np.mean(chosen) < 1.15 * np.mean(best)
    assert np.mean(chosen) < 1.05 * np.mean(fixed)


def test_on_few_nodes_a_quarter_of_what_they_say_stays_free() -> None:
    nodes = np.delete(grid(6, 5), [0, 5, 12, 24, 29, 17], axis=0)
    px = polynomial(nodes) + np.random.default_rng(3).normal(0, 0.05, nodes.shape)
    fits = fit_tensor_maps(nodes, px, convex_hull_mm(nodes))
    assert max(fit.parameters for fit in fits) <= 0.75 * 2 * len(nodes)


def test_noise_gain_grows_with_the_degree_while_the_misfit_falls() -> None:
    """The balance of Sec. 3.5.6, with the covariance of Eq. 3.53 by Monte Carlo."""
    rng = np.random.default_rng(4)
    px = polynomial(NODES) + rng.normal(0, 0.05, NODES.shape)
    fits = {fit.degree: fit for fit in fit_tensor_maps(NODES, px, HULL)}
    gains = [fits[d, 2].map.sigma_px / fits[d, 2].map.noise_px for d in (2, 3, 4, 5)]
    assert gains == sorted(gains)
    assert fits[5, 3].map.noise_px < 0.3 * fits[3, 3].map.noise_px

    points = fits[4, 2].map.dense_mm()
    repeats = [
        fit_tensor_map(NODES, polynomial(NODES) + rng.normal(0, 0.05, NODES.shape), HULL, (4, 2))
        for _ in range(200)
    ]
    scatter = np.std([fit.map.to_px(points) for fit in repeats], axis=0)
    predicted = np.mean([fit.map.sigma_px for fit in repeats])
    assert predicted / np.sqrt(np.mean(scatter**2)) == pytest.approx(1, abs=0.05)


def test_what_a_node_misses_the_map_by_that_never_saw_it() -> None:
    px = polynomial(NODES) + np.random.default_rng(5).normal(0, 0.05, NODES.shape)
    fit = fit_tensor_map(NODES, px, HULL, (4, 3))
    for node in (0, 8, 17, 34):
        rest = np.delete(np.arange(len(NODES)), node)
        without = fit_tensor_map(NODES[rest], px[rest], HULL, (4, 3)).map
        missed = px[node] - without.to_px(NODES[node : node + 1])[0]
        assert fit.leave_one_out_residuals_px[node] == pytest.approx(missed, abs=1e-8)


GRID: list[Cell] = [(column, row) for row in range(5) for column in range(6)]


def row(number: int) -> list[Cell]:
    return [(column, number) for column in range(6)]


def column(number: int) -> list[Cell]:
    return [(number, row) for row in range(5)]


@pytest.mark.parametrize(
    ("missing", "columns", "rows", "left"),
    [
        ([], 6, 5, 0),
        (row(4), 6, 5, 6),  # a fifth of all may be missing wherever it is
        ([*row(4), (2, 2)], 6, 4, 1),
        ([*row(0), *column(5)], 6, 4, 4),  # the row goes, and the column is a sixth of what is left
        ([*column(0), *column(5)], 5, 5, 5),
        ([*column(0), *column(5), (2, 2)], 4, 5, 1),
        (row(2), 6, 5, 6),
    ],
)
def test_a_grid_without_outer_rows_that_are_missing_is_sufficient(
    missing: list[Cell], columns: int, rows: int, left: int
) -> None:
    block = GridPart.within(GRID, missing)
    assert (len(block.columns), len(block.rows), block.missing) == (columns, rows, left)
    assert block.is_sufficient


@pytest.mark.parametrize(
    "missing",
    [
        [*row(0), *row(4)],  # three rows bear no map
        [*column(0), *column(1), *column(5)],
        [(column, row) for column, row in GRID if (column + row) % 3 == 0],  # a third of it, everywhere
        GRID,
    ],
)
def test_too_little_is_not_sufficient(missing: list[Cell]) -> None:
    assert not GridPart.within(GRID, missing).is_sufficient


def test_an_axis_goes_through_a_row_that_is_missing() -> None:
    axis = Axis.through(np.array([-50.0, -25.0, 25.0, 50.0, 75.0]))
    assert (axis.first_mm, axis.step_mm, axis.nodes) == (-50.0, 25.0, 6)
    assert axis.numbers(np.array([25.3, -50.0])).tolist() == [3, 0]


@pytest.mark.parametrize("nodes", [4, 5, 6, 7, 30])
def test_the_basis_is_orthonormal_on_its_nodes(nodes: int) -> None:
    basis = gram_basis(equidistant_nodes(nodes), nodes, nodes - 1)
    assert basis.T @ basis == pytest.approx(np.eye(nodes), abs=1e-8)


def test_the_basis_is_that_of_gram_schmidt_on_the_monomials() -> None:
    nodes = equidistant_nodes(7)
    q, r = np.linalg.qr(np.vander(nodes, 5, increasing=True))
    basis = gram_basis(nodes, 7, 4)
    assert basis == pytest.approx(q * np.sign(np.diag(r)), abs=1e-12)


def test_between_the_nodes_values_are_those_of_the_interpolating_polynomial() -> None:
    nodes, x = equidistant_nodes(6), np.linspace(-1.1, 1.1, 23)
    on_nodes, value = gram_basis(nodes, 6, 4), gram_basis(x, 6, 4)
    for degree in range(5):
        polynomial = np.polynomial.Polynomial.fit(nodes, on_nodes[:, degree], degree)
        assert value[:, degree] == pytest.approx(polynomial(x), abs=1e-9)


def test_the_powers_are_the_same_polynomials() -> None:
    x = np.linspace(-1, 1, 11)
    expected = np.polynomial.polynomial.polyval(x, gram_powers(6, 4).T).T
    assert gram_basis(x, 6, 4) == pytest.approx(expected, abs=1e-13)


def test_a_degree_that_the_nodes_cannot_carry_is_refused() -> None:
    with pytest.raises(ValueError, match="degree 5 needs at least 6 nodes"):
        gram_basis(np.zeros(1), 5, 5)
