from __future__ import annotations

import numpy as np
import pytest
from support.gram import equidistant_nodes

from altd.mapping.polynomials import gram_basis, gram_powers


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
