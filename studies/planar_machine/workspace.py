"""Workspace of the planar 3-PRP machine: the solid between the surfaces of Eq. 2.28–2.30 in (a, b, φ).

At one φ a joint is linear in (a, b). Each leg allows the strip between two lines parallel to its edge, and
the workspace is the overlap of the three strips, a convex polygon of at most six corners (Fig. 2.11). A strip
has no width at the φ of its type-1 singularity, so these orientations cut the solid into pieces.
"""

from itertools import pairwise

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from altd.records import FloatArray
from studies.planar_machine.kinematics import Machine, joints_of


def contains(machine: Machine, poses: ArrayLike) -> npt.NDArray[np.bool_]:
    """Whether all joints of poses (..., 3) are within their limits; False for a pose with a parallel leg."""
    joints = joints_of(machine, poses)
    with np.errstate(invalid="ignore"):
        inside = (joints >= machine.limits_mm[:, 0]) & (joints <= machine.limits_mm[:, 1])
    return np.asarray(inside.all(axis=-1))


def slice_mm(machine: Machine, phi_deg: float) -> FloatArray:
    """Corners (N, 2) of the workspace at one φ in (a, b), counter-clockwise; (0, 2) where there is none."""
    normals, strips = _strips(machine, phi_deg)
    strips.sort(axis=1)
    to_corner = np.linalg.inv(normals[:2])
    polygon = np.array(
        [to_corner @ (strips[0, i], strips[1, j]) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    )
    for sign, end in ((1.0, 0), (-1.0, 1)):
        polygon = _cut(polygon, sign * normals[2], sign * strips[2, end])
    return polygon if area_mm2(polygon) >= 0 else polygon[::-1]


def face_mm(machine: Machine, phi_deg: float, leg: int, end: int) -> FloatArray:
    """Ends (2, 2) of the side of the slice at one φ where a leg is at its first or last limit; or (0, 2).

    Over all φ it is a face of the solid, a part of one of the six surfaces of Eq. 2.28–2.30 (Fig. 2.10).
    """
    normals, strips = _strips(machine, phi_deg)
    along = np.array([normals[leg, 1], -normals[leg, 0]])
    foot = normals[leg] * strips[leg, end]
    low, high = -np.inf, np.inf
    for other in {0, 1, 2} - {leg}:
        ends = np.sort((strips[other] - normals[other] @ foot) / (normals[other] @ along))
        low, high = max(low, ends[0]), min(high, ends[1])
    return foot + np.outer((low, high), along) if low < high else np.empty((0, 2))


def _strips(machine: Machine, phi_deg: float) -> tuple[FloatArray, FloatArray]:
    """Normals (3, 2) of the edges, and n·(a, b) (3, 2) of each leg's two limits, at one φ."""
    angle = np.radians(machine.edge_deg + phi_deg)
    normals = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    strips = np.empty((3, 2))
    for end in (0, 1):
        points = machine.rail_points_mm(machine.limits_mm[:, end])
        strips[:, end] = np.einsum("ij,ij->i", normals, points) - machine.edge_offset_mm
    return normals, strips


def volume_mm2_deg(machine: Machine, first_deg: float, last_deg: float) -> float:
    """Volume between two φ, in mm² · °: Gauss–Legendre over φ, exact in a and b.

    The area has kinks where corners of the polygon meet, so the 400 points are split over twenty pieces.
    """
    nodes, weights = np.polynomial.legendre.leggauss(20)
    ends = np.linspace(first_deg, last_deg, 21)
    total = 0.0
    for low, high in pairwise(ends):
        middle, half = (low + high) / 2, (high - low) / 2
        areas = [area_mm2(slice_mm(machine, middle + half * node)) for node in nodes]
        total += half * float(np.dot(weights, areas))
    return total


def area_mm2(corners: FloatArray) -> float:
    """Area of a polygon (N, 2), positive where its corners are counter-clockwise."""
    x, y = corners.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


def _cut(polygon: FloatArray, normal: FloatArray, least: float) -> FloatArray:
    """Part of a convex polygon (N, 2) with normal·x >= ``least``."""
    kept: list[FloatArray] = []
    above = polygon @ normal - least
    for k in range(len(polygon)):
        after = (k + 1) % len(polygon)
        if above[k] >= 0:
            kept.append(polygon[k])
        if above[k] * above[after] < 0:
            kept.append(polygon[k] + (polygon[after] - polygon[k]) * above[k] / (above[k] - above[after]))
    return np.array(kept).reshape(-1, 2)
