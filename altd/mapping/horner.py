"""Bivariate polynomials of plain numbers, for one point at a time.

That is what the daemon asks for, and for one point numpy's calls cost ten times the arithmetic.
"""

from __future__ import annotations

from altd.records import FloatArray

Rows = tuple[tuple[float, ...], ...]
"""Coefficients c_ij of y^i x^j, rows by falling i and in them by falling j."""


def rows(powers: FloatArray) -> Rows:
    """A matrix of coefficients by rising powers, for Horner's rule."""
    return plain(powers[::-1, ::-1])


def plain(matrix: FloatArray) -> Rows:
    """A matrix as tuples of numbers."""
    return tuple(tuple(row) for row in matrix.tolist())


def horner(coefficients: Rows, x: float, y: float) -> float:
    """Σ c_ij x^j y^i."""
    value = 0.0
    for row in coefficients:
        along_x = 0.0
        for coefficient in row:
            along_x = along_x * x + coefficient
        value = value * y + along_x
    return value


def horner_with_slopes(coefficients: Rows, x: float, y: float) -> tuple[float, float, float]:
    """The same with its derivatives by x and by y."""
    value = slope_x = slope_y = 0.0
    for row in coefficients:
        along_x = slope = 0.0
        for coefficient in row:
            slope = slope * x + along_x
            along_x = along_x * x + coefficient
        slope_y = slope_y * y + value
        slope_x = slope_x * y + slope
        value = value * y + along_x
    return value, slope_x, slope_y
