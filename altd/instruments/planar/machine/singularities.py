"""Singular poses of the planar 3-PRP machine (§2.3.5), where it loses or gains a degree of freedom.

Type 1: a rail is parallel to its edge, and moving the joint does not move the EE. This depends on φ alone.
Type 2: the normals of the edges in the driven points meet in one point (Eq. 2.37), and the EE can turn about
it with locked joints. At one φ these poses form a straight line in (a, b). Type 3: both.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from altd.instruments.planar.machine.kinematics import PlanarMachine
from altd.records import FloatArray


def parallel_orientations_deg(machine: PlanarMachine) -> FloatArray:
    """φ (3,) in (−90°, 90°] at which each rail is parallel to its edge (type 1); so is φ + 180°."""
    orientations: FloatArray = 90.0 - np.mod(90.0 - (machine.rail_deg - machine.edge_deg), 180.0)
    return orientations


class Line(NamedTuple):
    """The singular poses of type 2 at one φ: ``normal`` · (a, b) = ``offset_mm``, |normal| = 1."""

    normal: FloatArray
    offset_mm: FloatArray


def concurrent_line(machine: PlanarMachine, phi_deg: ArrayLike) -> Line:
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
