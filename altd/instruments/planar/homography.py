"""Homography of a plane, by its vanishing line and Gauss–Newton (Eq. 2.44–2.58), without distortion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from altd.records import FloatArray

_MIN_POINTS = 4
_MAX_ITERATIONS = 50
_CONVERGED = 1e-12
_DEGENERATE_BELOW = 1e-9


def fit_homography(source: FloatArray, target: FloatArray) -> FloatArray:
    """Fit the homography (3, 3) from points (n, 2) to points (n, 2) by least squares in the target.

    ``vanishing_line_homography`` gives the initial estimate, Gauss–Newton refines it (Eq. 2.54–2.58). The
    thesis fits the rims of circular spots of radius r. For their centres r is 0, and the distance of Eq. 2.54
    is replaced by its two components, because its own derivative does not exist at 0. Raises ValueError when
    there are fewer than four points or they leave the homography undetermined.
    """
    (to_unit, here), (to_unit_there, there) = _normalised(source), _normalised(target)
    h = vanishing_line_homography(here, there)
    if abs(h[2, 2]) < _DEGENERATE_BELOW:
        raise ValueError("the middle of the points lies on the vanishing line")
    h = h / h[2, 2]
    before = np.inf
    for _ in range(_MAX_ITERATIONS):
        mapped, slopes = with_slopes(h, here)
        miss = (mapped - there).ravel()
        squares = float(miss @ miss)
        if not squares < before * (1 - _CONVERGED):
            break
        before, best = squares, h
        step = np.append(-np.linalg.lstsq(slopes, miss, rcond=None)[0], 0.0)  # Eq. 2.58; h9 stays 1
        h = h + step.reshape(3, 3)
    h = np.linalg.inv(to_unit_there) @ best @ to_unit
    return np.asarray(h / h[2, 2])


def fit_rims(h: FloatArray, rims: Sequence[FloatArray], middles: FloatArray, radius: float) -> FloatArray:
    """Fit the homography whose mapped rim points are closest to circles about ``middles`` (m, 2).

    ``rims`` holds the rim points (n, 2) of each circle in the source plane, ``h`` is the initial homography.
    Gauss–Newton minimises the distances of Eq. 2.54; their sum of squares does not grow. Blur in a picture
    moves all rims alike, so the radius, which the source takes as known, is fitted too.
    """
    (to_unit, here), (to_unit_there, there) = _normalised(np.concatenate(rims)), _normalised(middles)
    of_circle = np.repeat(np.arange(len(rims)), [len(rim) for rim in rims])
    h = to_unit_there @ h @ np.linalg.inv(to_unit)
    best, r, before = h / h[2, 2], radius * to_unit_there[0, 0], np.inf
    at, at_radius = best, r
    for _ in range(_MAX_ITERATIONS):
        mapped, slopes = with_slopes(at, here)
        off = mapped - there[of_circle]
        distance = np.maximum(np.linalg.norm(off, axis=1), _DEGENERATE_BELOW)
        miss = distance - at_radius  # Eq. 2.54
        squares = float(miss @ miss)
        if not squares < before * (1 - _CONVERGED):
            break
        before, best = squares, at
        along = np.einsum("nc,ncp->np", off / distance[:, None], slopes.reshape(-1, 2, 8))
        step = -np.linalg.lstsq(np.column_stack([along, -np.ones(len(miss))]), miss, rcond=None)[0]
        at = at + np.append(step[:8], 0.0).reshape(3, 3)  # Eq. 2.58; h9 stays 1
        at_radius += float(step[8])
    h = np.linalg.inv(to_unit_there) @ best @ to_unit
    return np.asarray(h / h[2, 2])


def vanishing_line_homography(source: FloatArray, target: FloatArray) -> FloatArray:
    """Homography (3, 3) of least algebraic residuals, with a vanishing line of norm 1 (Eq. 2.44–2.53).

    Eq. 2.50 is printed with I − PP⁺ next to X′P and Y′P; Eq. 2.49 implies their product. Raises ValueError
    when there are fewer than four points or they leave the homography undetermined.
    """
    if len(source) < _MIN_POINTS:
        raise ValueError(f"{len(source)} points are too few for a homography")
    plane = np.column_stack([source, np.ones(len(source))])  # P, Eq. 2.45
    if np.linalg.matrix_rank(plane, tol=_DEGENERATE_BELOW * np.linalg.norm(plane)) < 3:
        raise ValueError("the points lie on a line")
    inverse = np.linalg.pinv(plane)
    seen = [-coordinate[:, None] * plane for coordinate in target.T]  # X′P and Y′P, Eq. 2.47
    d = np.vstack([part - plane @ (inverse @ part) for part in seen])
    _, singular, rows = np.linalg.svd(d, full_matrices=False)
    if singular[1] < _DEGENERATE_BELOW * np.linalg.norm(np.vstack(seen)):
        raise ValueError("the points leave the homography undetermined")
    line = rows[-1]  # g3, Eq. 2.51: the smallest singular value's
    return np.array([*(-inverse @ (part @ line) for part in seen), line])  # g1 and g2, Eq. 2.49


def apply_homography(homography: FloatArray, points: FloatArray) -> FloatArray:
    """Map points (n, 2), Eq. 2.55 and 2.56."""
    mapped: FloatArray = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return mapped[:, :2] / mapped[:, 2:]


def with_slopes(h: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mapped points, and their derivatives by h1 … h8 as (2 n, 8)."""
    plane = np.column_stack([points, np.ones(len(points))])
    mapped = plane @ h.T
    places = mapped[:, :2] / mapped[:, 2:]
    scaled = plane / mapped[:, 2:]
    nothing = np.zeros_like(scaled)
    of_x = np.hstack([scaled, nothing, -places[:, :1] * scaled[:, :2]])
    of_y = np.hstack([nothing, scaled, -places[:, 1:] * scaled[:, :2]])
    return places, np.stack([of_x, of_y], axis=1).reshape(-1, 8)


def _normalised(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Similarity that centres points (n, 2) at 0 with a mean distance of √2, and the transformed points."""
    middle = points.mean(axis=0)
    scale = np.sqrt(2) / max(float(np.linalg.norm(points - middle, axis=1).mean()), _DEGENERATE_BELOW)
    similarity = np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1.0]])
    return similarity, (points - middle) * scale
