"""Kinematics of a planar 3-PRP machine: three driven points, each on an edge of the moving triangle (§2.3).

A joint moves a point along a fixed rail; an edge of the moving triangle (the end effector, EE) slides and
turns on that point. Poses are arrays (..., 3) of a_mm, b_mm, phi_deg: the displacement of the EE frame in
the fixed frame (Eq. 2.8). Joints are arrays (..., 3) in mm along each rail from its start.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from altd.records import FloatArray

_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class PlanarMachine:
    """Geometry: a rail and an edge for each of three legs; every array has one row or entry per leg.

    ``rail_start_mm`` (3, 2) and ``rail_deg`` (3,) are in the fixed frame, ``edge_deg`` (3,) and
    ``edge_offset_mm`` (3,) in the frame of the EE. An edge holds the points x with n·x = offset; its normal n
    is its direction turned by +90°. ``limits_mm`` (3, 2) holds the minimum and maximum of each joint,
    ``joint_scale`` (3,) its true travel per stated travel.
    """

    rail_start_mm: FloatArray
    rail_deg: FloatArray
    edge_deg: FloatArray
    edge_offset_mm: FloatArray
    limits_mm: FloatArray
    joint_scale: FloatArray = field(default_factory=lambda: np.ones(3))

    @property
    def parameters(self) -> FloatArray:
        """Array (3, 6), a row per leg: start of the rail (x, y), its direction, scale, edge, its offset."""
        columns = self.rail_deg, self.joint_scale, self.edge_deg, self.edge_offset_mm
        return np.column_stack([self.rail_start_mm, *columns])

    @property
    def weights(self) -> FloatArray:
        """Weights w (3,) with Σ w n = 0 for the normals n of the edges; proportional to the sides."""
        second, third = np.roll(self.edge_deg, -1), np.roll(self.edge_deg, -2)
        weights: FloatArray = np.sin(np.radians(third - second))
        return weights

    def rail_points_mm(self, joints_mm: ArrayLike) -> FloatArray:
        """Driven points (..., 3, 2) in the fixed frame, mm."""
        joints = np.asarray(joints_mm, float)
        travel = joints * self.joint_scale
        points: FloatArray = self.rail_start_mm + travel[..., None] * _direction(np.radians(self.rail_deg))
        return points

    def crossing_sines(self, phi_deg: ArrayLike) -> FloatArray:
        """Sine (..., 3) of the angle from each edge to its rail; a leg with sine 0 is singular (type 1)."""
        sines: FloatArray = np.sin(
            np.radians(self.rail_deg - self.edge_deg - np.asarray(phi_deg, float)[..., None])
        )
        return sines


def poses_of(machine: PlanarMachine, joints_mm: ArrayLike) -> FloatArray:
    """Forward kinematics: poses (..., 2, 3) of both assembly modes, NaN where the machine cannot close.

    The weighted sum of the three constraints n·P − n·(a, b) = offset is free of (a, b), because Σ w n = 0. It
    is A cos φ + B sin φ = C, so φ = atan2(B, A) ± acos(C / √(A² + B²)): mode 0 has the plus sign. φ is in
    (−180°, 180°].
    """
    points = machine.rail_points_mm(joints_mm)
    weights, normals = machine.weights, _normal(np.radians(machine.edge_deg))
    cosine = np.einsum("i,ij,...ij->...", weights, normals, points)
    turned = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    sine = np.einsum("i,ij,...ij->...", weights, turned, points)
    wanted = float(weights @ machine.edge_offset_mm)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = wanted / np.hypot(cosine, sine)
        closes = np.abs(ratio) <= 1.0 + _ROUNDING  # in a pose of type 2 it is 1
        half = np.arccos(np.where(closes, np.clip(ratio, -1.0, 1.0), np.nan))
    middle = np.arctan2(sine, cosine)
    phi = np.stack([middle + half, middle - half], axis=-1)
    rotation = _rotation(phi)
    in_ee = np.einsum("...kji,...pj->...kpi", rotation, points)  # R(−φ) P, for each mode
    distances = np.einsum("pi,...kpi->...kp", normals, in_ee) - machine.edge_offset_mm
    origin = np.einsum("ip,...kp->...ki", np.linalg.pinv(normals), distances)
    place = np.einsum("...kij,...kj->...ki", rotation, origin)
    phi_deg = 180.0 - np.mod(180.0 - np.degrees(phi), 360.0)
    return np.concatenate([place, phi_deg[..., None]], axis=-1)


def gaps_mm(machine: PlanarMachine, poses: ArrayLike, joints_mm: ArrayLike) -> FloatArray:
    """Distance (..., 3) of each driven point from its edge along the normal, 0 where the machine closes."""
    pose = np.asarray(poses, float)
    normals = _normal(np.radians(machine.edge_deg + pose[..., 2, None]))
    lever = machine.rail_points_mm(joints_mm) - pose[..., None, :2]
    gaps: FloatArray = np.einsum("...ij,...ij->...i", normals, lever) - machine.edge_offset_mm
    return gaps


def constraint_jacobian(machine: PlanarMachine, poses: ArrayLike, joints_mm: ArrayLike) -> FloatArray:
    """K (..., 3, 3): distance (mm) of each edge from its driven point, per mm in a and b and radian in φ.

    K d(a, b, φ) = sines · joint_scale · d(joints). It has no inverse where the normals of the edges in the
    driven points meet in one point (type 2).
    """
    pose = np.asarray(poses, float)
    edge_rad = np.radians(machine.edge_deg + pose[..., 2, None])
    lever = machine.rail_points_mm(joints_mm) - pose[..., None, :2]
    along = np.einsum("...ij,...ij->...i", _direction(edge_rad), lever)
    return np.concatenate([_normal(edge_rad), along[..., None]], axis=-1)


def _direction(angle_rad: FloatArray) -> FloatArray:
    return np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)


def _normal(angle_rad: FloatArray) -> FloatArray:
    return np.stack([-np.sin(angle_rad), np.cos(angle_rad)], axis=-1)


def _rotation(angle_rad: FloatArray) -> FloatArray:
    """Rotation matrices (..., 2, 2)."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack([np.stack([cosine, -sine], axis=-1), np.stack([sine, cosine], axis=-1)], axis=-2)
