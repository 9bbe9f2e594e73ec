"""Workspace of the planar 3-PRP machine: the solid between the surfaces of Eq. 2.28–2.30 in (a, b, φ).

At one φ a joint is linear in (a, b). Each leg allows the strip between two lines parallel to its edge, and
the workspace is the overlap of the three strips, a convex polygon of at most six corners (Fig. 2.11). A strip
has no width at the φ of its type-1 singularity, so these orientations cut the solid into pieces.
"""

import numpy as np

from altd.instruments.planar.machine.kinematics import PlanarMachine
from altd.instruments.planar.machine.singularities import concurrent_line
from altd.records import FloatArray


def slice_mm(machine: PlanarMachine, phi_deg: float) -> FloatArray:
    """Corners (N, 2) of the workspace at one φ in (a, b), counter-clockwise; (0, 2) where there is none."""
    normals, strips = strips_mm(machine, phi_deg)
    strips.sort(axis=1)
    to_corner = np.linalg.inv(normals[:2])
    polygon = np.array(
        [to_corner @ (strips[0, i], strips[1, j]) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    )
    for sign, end in ((1.0, 0), (-1.0, 1)):
        polygon = _cut(polygon, sign * normals[2], sign * strips[2, end])
    return polygon if area_mm2(polygon) >= 0 else polygon[::-1]


def type_2_range_mm(machine: PlanarMachine, phi_deg: float) -> tuple[float, float]:
    """Smallest and largest signed distance of the slice at φ from the line of type 2; NaN if it is empty."""
    corners, line = slice_mm(machine, phi_deg), concurrent_line(machine, phi_deg)
    if not len(corners):
        return np.nan, np.nan
    distance = corners @ line.normal - line.offset_mm
    return float(distance.min()), float(distance.max())


def strips_mm(machine: PlanarMachine, phi_deg: float) -> tuple[FloatArray, FloatArray]:
    """Normals (3, 2) of the edges, and n·(a, b) (3, 2) of each leg's two limits, at one φ."""
    angle = np.radians(machine.edge_deg + phi_deg)
    normals = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    strips = np.empty((3, 2))
    for end in (0, 1):
        points = machine.rail_points_mm(machine.limits_mm[:, end])
        strips[:, end] = np.einsum("ij,ij->i", normals, points) - machine.edge_offset_mm
    return normals, strips


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
