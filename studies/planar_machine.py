"""The source's double triangular manipulator (§2.3): inverse kinematics, image space, the solid workspace."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from altd.instruments.planar.machine.kinematics import PlanarMachine, gaps_mm
from altd.instruments.planar.machine.workspace import area_mm2, slice_mm, strips_mm
from altd.records import FloatArray

_PARALLEL = 1e-12
"""|sin| of the angle between rail and edge below which a joint is undetermined."""


def machine_of_triangles(fixed_mm: ArrayLike, moving_mm: ArrayLike) -> PlanarMachine:
    """Machine of two triangles by their vertices, (3, 2) each; leg i is on side i of both.

    Side i connects the vertices i and i + 1; the joints may use whole rails (Fig. 2.9, Eq. 2.18–2.21).
    """
    fixed, moving = np.asarray(fixed_mm, float), np.asarray(moving_mm, float)
    rails = np.roll(fixed, -1, axis=0) - fixed
    edges = np.roll(moving, -1, axis=0) - moving
    edge_deg = np.degrees(np.arctan2(edges[:, 1], edges[:, 0]))
    offset = np.einsum("ij,ij->i", _normal(np.radians(edge_deg)), moving)
    lengths = np.hypot(*rails.T)
    limits = np.stack([np.zeros(3), lengths], axis=1)
    rail_deg = np.degrees(np.arctan2(rails[:, 1], rails[:, 0]))
    return PlanarMachine(fixed, rail_deg, edge_deg, offset, limits)


def double_triangle(base_mm: float = 500.0) -> PlanarMachine:
    """Machine of the source: two equal isosceles triangles, long to short side 6 : 5 (§2.3.2).

    The source does not print its dimensions. The rails are base, right and left leg of the fixed triangle,
    with O at the origin and the base along x. Only one assignment of edges to rails gives Eq. 2.64: at φ = 0
    the edges are parallel to the right leg, the left leg and the base.
    """
    leg_mm = 1.2 * base_mm
    half, height = base_mm / 2, (leg_mm**2 - base_mm**2 / 4) ** 0.5
    fixed = [(0.0, 0.0), (base_mm, 0.0), (half, height)]
    moving = [(0.0, 0.0), (half, -height), (base_mm, 0.0)]
    return machine_of_triangles(fixed, moving)


def joints_of(machine: PlanarMachine, poses: ArrayLike) -> FloatArray:
    """Inverse kinematics: the joints (..., 3) in mm of poses (..., 3).

    A joint is NaN where its rail and its edge are parallel. Limits are not applied.
    """
    pose = np.asarray(poses, float)
    sines = machine.crossing_sines(pose[..., 2])
    safe = np.where(np.abs(sines) < _PARALLEL, np.nan, sines)
    joints: FloatArray = -gaps_mm(machine, pose, np.zeros(3)) / (safe * machine.joint_scale)
    return joints


def contains(machine: PlanarMachine, poses: ArrayLike) -> npt.NDArray[np.bool_]:
    """Whether all joints of poses (..., 3) are within their limits; False for a pose with a parallel leg."""
    joints = joints_of(machine, poses)
    with np.errstate(invalid="ignore"):
        inside = (joints >= machine.limits_mm[:, 0]) & (joints <= machine.limits_mm[:, 1])
    return np.asarray(inside.all(axis=-1))


def image_points(poses: ArrayLike) -> FloatArray:
    """Points X0 … X3 (..., 4) of poses in the kinematic image space (Eq. 2.9)."""
    pose = np.asarray(poses, float)
    a, b, half = pose[..., 0], pose[..., 1], np.radians(pose[..., 2]) / 2
    cosine, sine = np.cos(half), np.sin(half)
    return np.stack([2 * cosine, a * sine - b * cosine, a * cosine + b * sine, 2 * sine], axis=-1)


def quadrics(machine: PlanarMachine, joints_mm: ArrayLike) -> FloatArray:
    """Q (..., 3, 4, 4), symmetric: X′QX = 0 holds for the poses in which leg i closes (Eq. 2.22–2.24).

    X′QX = P′A*l with the line l of the edge, the driven point P and A* of Eq. 2.17; the sign of s₁ in the
    printed Eq. 2.22 and 2.28 does not fit Eq. 2.9 and 2.17.
    """
    normals = _normal(np.radians(machine.edge_deg))
    line0, (line1, line2) = -machine.edge_offset_mm, normals.T
    x, y = np.moveaxis(machine.rail_points_mm(joints_mm), -1, 0)
    shape = x.shape
    form = np.zeros((*shape, 4, 4))
    straight, crossed = line1 * x + line2 * y, line1 * y - line2 * x
    form[..., 0, 0] = line0 + straight
    form[..., 3, 3] = line0 - straight
    for row, column, value in (
        (0, 3, 2 * crossed),
        (0, 1, 2 * line2),
        (0, 2, -2 * line1),
        (1, 3, 2 * line1),
        (2, 3, 2 * line2),
    ):
        form[..., row, column] = form[..., column, row] = value / 2
    return form


def absolute_lines(machine: PlanarMachine, joints_mm: ArrayLike) -> FloatArray:
    """Lines l (..., 3, 3), l · (X1, X2, X3) = 0, in which each quadric meets X0 = 0 (Eq. 2.25–2.27).

    A quadric meets this plane in X3 = 0 too, the line that all three share. With two real lines there it is a
    hyperbolic paraboloid.
    """
    form = quadrics(machine, joints_mm)
    return np.stack([2 * form[..., 1, 3], 2 * form[..., 2, 3], form[..., 3, 3]], axis=-1)


def image_determinant(machine: PlanarMachine, poses: ArrayLike) -> FloatArray:
    """Determinant B (...) of Eq. 2.33, cleared of the joints' denominators, at poses (..., 3).

    The rows of B are the gradients of the three quadrics and of X0² + X3² = 4 in the image space. A quadric's
    row is linear in its joint = distance / sine, so a row times its sine is finite in every pose. The product
    is zero for poses of type 2, and where a rail and its edge coincide (type 1). Its scale is that of
    ``quadrics``.
    """
    pose = np.asarray(poses, float)
    start, slope = (
        quadrics(machine, np.zeros(3)),
        quadrics(machine, np.ones(3)) - quadrics(machine, np.zeros(3)),
    )
    sines = machine.crossing_sines(pose[..., 2])
    travel = -gaps_mm(machine, pose, np.zeros(3)) / machine.joint_scale
    forms = sines[..., None, None] * start + travel[..., None, None] * slope
    points = image_points(pose)
    gradients = 2 * np.einsum("...pij,...j->...pi", forms, points)
    last = 2 * points * np.array([1.0, 0.0, 0.0, 1.0])
    determinant: FloatArray = np.linalg.det(np.concatenate([gradients, last[..., None, :]], axis=-2))
    return determinant


def face_mm(machine: PlanarMachine, phi_deg: float, leg: int, end: int) -> FloatArray:
    """Ends (2, 2) of the side of the slice at one φ where a leg is at its first or last limit; or (0, 2).

    Over all φ it is a face of the solid, a part of one of the six surfaces of Eq. 2.28–2.30 (Fig. 2.10).
    """
    normals, strips = strips_mm(machine, phi_deg)
    along = np.array([normals[leg, 1], -normals[leg, 0]])
    foot = normals[leg] * strips[leg, end]
    low, high = -np.inf, np.inf
    for other in {0, 1, 2} - {leg}:
        ends = np.sort((strips[other] - normals[other] @ foot) / (normals[other] @ along))
        low, high = max(low, ends[0]), min(high, ends[1])
    return foot + np.outer((low, high), along) if low < high else np.empty((0, 2))


def volume_mm2_deg(machine: PlanarMachine, first_deg: float, last_deg: float) -> float:
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


def _normal(angle_rad: FloatArray) -> FloatArray:
    return np.stack([-np.sin(angle_rad), np.cos(angle_rad)], axis=-1)
