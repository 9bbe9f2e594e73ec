"""Map px → mm by Newton's method on the tensor map from a direct polynomial start."""

from __future__ import annotations

import math

import numpy as np

from altd.mapping.grid import edge_lines
from altd.mapping.polynomials import Rows, horner, horner_with_slopes, plain, rows
from altd.mapping.tensor_map import TensorMap
from altd.records import FloatArray

_START_DEGREE = 3
_MAX_ITERATIONS = 12
_CONVERGED_PX = 1e-6
_HULL_SIGMAS = 3.0
_MAX_SIGMA_OUTSIDE_MM = 0.05
"""Maximum sigma outside the nodes' hull, per axis: the accuracy of Tables 3.3 and 3.4."""
_MIN_DETERMINANT = 1e-12

_UNKNOWN = ((math.nan, math.nan), (math.nan, math.nan))


class InverseMap:
    """Inverse of a tensor map, with its start: a polynomial x(u, v), y(u, v) of total degree 3."""

    def __init__(self, forward: TensorMap) -> None:
        """Fit the start to a dense grid over the map's own grid."""
        self.forward = forward
        x = np.linspace(forward.x_axis.first_mm, forward.x_axis.last_mm, 4 * forward.x_axis.nodes)
        y = np.linspace(forward.y_axis.first_mm, forward.y_axis.last_mm, 4 * forward.y_axis.nodes)
        points_mm = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        px = forward.to_px(points_mm)
        centre = px.mean(axis=0)
        self._centre_px = float(centre[0]), float(centre[1])
        self._scale_px = float(np.abs(px - centre).max())
        q = (px - centre) / self._scale_px
        start = np.asarray(np.linalg.lstsq(_monomials(q), points_mm, rcond=None)[0])
        self._start_x, self._start_y = rows(_triangle(start[:, 0])), rows(_triangle(start[:, 1]))
        u, v, self._spread_px = forward.powers()
        self._u, self._v = rows(u), rows(v)
        pattern = forward.noise_covariance_px2
        self._pattern_px2 = float(pattern[0, 0]), float(pattern[0, 1]), float(pattern[1, 1])
        self._edges = plain(edge_lines(forward.hull_mm))
        jacobian = forward.jacobian(forward.hull_mm.mean(axis=0, keepdims=True))[0]
        self._handed = float(np.sign(np.linalg.det(jacobian)))
        """Sign of the determinant of d(u, v)/d(x, y) where the map is not folded over."""

    def to_mm(self, points_px: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Map points (n, 2) px to (n, 2) mm.

        Returns the points, d(x, y)/d(u, v) as (n, 2, 2) mm/px, and the covariance (n, 2, 2) mm² of the map's
        own noise: the scatter of a single place about the map (print and speckle are fixed patterns, so
        averaging does not remove it), and the uncertainty of the map itself, which increases outside the
        hull. A point is NaN if Newton does not converge, if it is beyond a fold of the map, or if it is
        outside the hull by more than three of its sigmas and either beyond the map's margin or too uncertain
        there.
        """
        mm = np.empty((len(points_px), 2))
        inverse_jacobian = np.empty((len(points_px), 2, 2))
        covariance = np.empty((len(points_px), 2, 2))
        for index, (u_px, v_px) in enumerate(points_px.tolist()):
            mm[index], inverse_jacobian[index], covariance[index] = self._one(u_px, v_px)
        return mm, inverse_jacobian, covariance

    def _one(self, u_px: float, v_px: float) -> tuple[tuple[float, float], Rows, Rows]:
        x_axis, y_axis = self.forward.x_axis, self.forward.y_axis
        per_x, per_y = x_axis.unit_per_mm, y_axis.unit_per_mm
        middle_x, middle_y = (x_axis.first_mm + x_axis.last_mm) / 2, (y_axis.first_mm + y_axis.last_mm) / 2
        reach_x, reach_y = (x_axis.last_mm - x_axis.first_mm) / 4, (y_axis.last_mm - y_axis.first_mm) / 4
        a, b = (u_px - self._centre_px[0]) / self._scale_px, (v_px - self._centre_px[1]) / self._scale_px
        x, y = horner(self._start_x, b, a), horner(self._start_y, b, a)
        for _ in range(_MAX_ITERATIONS):
            q, r = (x - middle_x) * per_x, (y - middle_y) * per_y
            u, ux, uy = horner_with_slopes(self._u, q, r)
            v, vx, vy = horner_with_slopes(self._v, q, r)
            ux, vx, uy, vy = ux * per_x, vx * per_x, uy * per_y, vy * per_y
            determinant = ux * vy - uy * vx
            if not abs(determinant) >= _MIN_DETERMINANT:  # written so that NaN is singular too
                break
            xu, xv, yu, yv = vy / determinant, -uy / determinant, -vx / determinant, ux / determinant
            miss_u, miss_v = u_px - u, v_px - v
            if abs(miss_u) < _CONVERGED_PX and abs(miss_v) < _CONVERGED_PX:
                if determinant * self._handed < 0:  # beyond a fold, where the map is reversed
                    break
                return self._judged(x, y, ((xu, xv), (yu, yv)))
            x += min(max(xu * miss_u + xv * miss_v, -reach_x), reach_x)
            y += min(max(yu * miss_u + yv * miss_v, -reach_y), reach_y)
        return (math.nan, math.nan), _UNKNOWN, _UNKNOWN

    def _judged(self, x: float, y: float, inverse_jacobian: Rows) -> tuple[tuple[float, float], Rows, Rows]:
        """Return a point found, with its covariance; NaN where the map is not known."""
        (xu, xv), (yu, yv) = inverse_jacobian
        uu, uv, vv = self._variance_px2(x, y)
        outside_mm = self.outside_mm(x, y)
        at_hull_mm2 = (xu * xu + yu * yu) * uu + 2 * (xu * xv + yu * yv) * uv + (xv * xv + yv * yv) * vv
        if outside_mm > 0.0:
            beyond = (self.forward.beyond_px_per_mm * outside_mm) ** 2
            uu, vv = uu + beyond, vv + beyond
        xy = xu * yu * uu + (xu * yv + xv * yu) * uv + xv * yv * vv
        covariance = (
            (xu * xu * uu + 2 * xu * xv * uv + xv * xv * vv, xy),
            (xy, yu * yu * uu + 2 * yu * yv * uv + yv * yv * vv),
        )
        xx, yy = covariance[0][0], covariance[1][1]
        known = outside_mm <= _HULL_SIGMAS * math.sqrt(at_hull_mm2) or (
            outside_mm <= self.forward.margin_mm and max(xx, yy) <= _MAX_SIGMA_OUTSIDE_MM**2
        )
        return (x, y) if known else (math.nan, math.nan), inverse_jacobian, covariance

    def outside_mm(self, x_mm: float, y_mm: float) -> float:
        """Return the distance of a place from the nodes' hull, across its farthest edge; negative inside."""
        return max(nx * x_mm + ny * y_mm - offset for nx, ny, offset in self._edges)

    def difference_mm2(
        self, now_mm: FloatArray, before_mm: FloatArray, mm_per_px: FloatArray, changed: FloatArray
    ) -> FloatArray:
        """Return the covariance (2, 2) mm² by this map of the difference of two near places (2,) mm.

        The map's own uncertainty cancels as far as it is equal at both. ``changed`` (2, 2) is the share of
        the map's noise by which the pattern differs between them: 0 at the same place, I far away.
        """
        of_map = self._row(*now_mm.tolist()) - self._row(*before_mm.tolist())
        of_u, of_v = of_map @ self._spread_px
        uu, uv, vv = self._pattern_px2
        pattern = mm_per_px @ np.array([[uu, uv], [uv, vv]]) @ mm_per_px.T
        differs = changed @ pattern
        spread = mm_per_px @ np.stack([of_u, of_v])
        outside_mm = [max(self.outside_mm(*place.tolist()), 0.0) for place in (now_mm, before_mm)]
        farther_mm = outside_mm[0] - outside_mm[1]
        beyond = (self.forward.beyond_px_per_mm * farther_mm) ** 2 * mm_per_px @ mm_per_px.T
        covariance: FloatArray = differs + differs.T + spread @ spread.T + beyond
        return covariance

    def _variance_px2(self, x: float, y: float) -> tuple[float, float, float]:
        """Return uu, uv and vv of the covariance of u and v: the place's own pattern and the map's spread."""
        of_u, of_v = self._row(x, y) @ self._spread_px
        uu, uv, vv = self._pattern_px2
        return uu + float(of_u @ of_u), uv + float(of_u @ of_v), vv + float(of_v @ of_v)

    def _row(self, x: float, y: float) -> FloatArray:
        """Return the powers y^i x^j of a place, in the axes' units."""
        x_axis, y_axis = self.forward.x_axis, self.forward.y_axis
        q = (x - (x_axis.first_mm + x_axis.last_mm) / 2) * x_axis.unit_per_mm
        r = (y - (y_axis.first_mm + y_axis.last_mm) / 2) * y_axis.unit_per_mm
        degree_x, degree_y = self.forward.degree
        along_x, along_y = [q**j for j in range(degree_x + 1)], [r**i for i in range(degree_y + 1)]
        return np.array([in_y * in_x for in_y in along_y for in_x in along_x])


def _triangle(start: FloatArray) -> FloatArray:
    """Return the start's coefficients as a matrix: row i of u^i, column j of v^j."""
    matrix = np.zeros((_START_DEGREE + 1, _START_DEGREE + 1))
    matrix[[i for i, _ in _EXPONENTS], [j for _, j in _EXPONENTS]] = start
    return matrix


_EXPONENTS = tuple((i, j) for i in range(_START_DEGREE + 1) for j in range(_START_DEGREE + 1 - i))


def _monomials(q: FloatArray) -> FloatArray:
    """Return all monomials up to the start's total degree of points (n, 2)."""
    return np.stack([q[:, 0] ** i * q[:, 1] ** j for i, j in _EXPONENTS], axis=-1)
