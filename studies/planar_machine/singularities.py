"""Singular poses of the planar 3-PRP machine (§2.3.5), where it loses or gains a degree of freedom.

Type 1: a rail is parallel to its edge, and moving the joint does not move the EE. This depends on φ alone.
Type 2: the normals of the edges in the driven points meet in one point (Eq. 2.37), and the EE can turn about
it with locked joints. At one φ these poses form a straight line in (a, b). Type 3: both.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from altd.records import FloatArray
from studies.planar_machine.kinematics import (
    Machine,
    distances_mm,
    image_points,
    quadrics,
)


def parallel_orientations_deg(machine: Machine) -> FloatArray:
    """φ (3,) in (−90°, 90°] at which each rail is parallel to its edge (type 1); so is φ + 180°."""
    orientations: FloatArray = 90.0 - np.mod(90.0 - (machine.rail_deg - machine.edge_deg), 180.0)
    return orientations


class Line(NamedTuple):
    """The singular poses of type 2 at one φ: ``normal`` · (a, b) = ``offset_mm``, |normal| = 1."""

    normal: FloatArray
    offset_mm: FloatArray


def concurrent_line(machine: Machine, phi_deg: ArrayLike) -> Line:
    """Poses of type 2 at each φ (...): normals (..., 2) and offsets (...) of straight lines in (a, b).

    A driven point is where its rail m·x = e crosses its edge, t = (e − m·(a, b) − offset m·n) / sine along
    the edge. The normals meet in one point where Σ w t = 0, which is linear in (a, b). Where a rail is
    parallel to its edge, the line holds the poses in which both coincide: type 1.
    """
    phi = np.asarray(phi_deg, float)
    rail, edge = np.radians(machine.rail_deg), np.radians(machine.edge_deg + phi[..., None])
    normals = np.stack([-np.sin(rail), np.cos(rail)], axis=-1)
    places = np.einsum("ij,ij->i", normals, machine.rail_start_mm)
    sines = machine.crossing_sines(phi)
    # Multiplied by all three sines, so that it stays finite where one is 0.
    factors = machine.weights * np.roll(sines, -1, axis=-1) * np.roll(sines, -2, axis=-1)
    offset = np.sum(factors * (places - machine.edge_offset_mm * np.cos(rail - edge)), axis=-1)
    normal = np.einsum("...i,ij->...j", factors, normals)
    with np.errstate(invalid="ignore", divide="ignore"):
        length = np.hypot(normal[..., 0], normal[..., 1])
        return Line(normal / length[..., None], offset / length)


def image_determinant(machine: Machine, poses: ArrayLike) -> FloatArray:
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
    travel = distances_mm(machine, pose) / machine.joint_scale
    forms = sines[..., None, None] * start + travel[..., None, None] * slope
    points = image_points(pose)
    gradients = 2 * np.einsum("...pij,...j->...pi", forms, points)
    last = 2 * points * np.array([1.0, 0.0, 0.0, 1.0])
    determinant: FloatArray = np.linalg.det(np.concatenate([gradients, last[..., None, :]], axis=-2))
    return determinant
