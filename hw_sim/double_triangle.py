"""The source's planar 3-PRP machine (§2.3.2): steppers move three points, the moving triangle follows.

The pose is found by following the closure of the mechanism from where the machine is, as the real one moves;
so it stays in its assembly mode and jams where the closure has no further solution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

STEP_MM = 0.025
"""Ball screws of 5 mm pitch, 200 steps a turn (§2.4.5)."""
_STRIDE_MM = 2.0
_CLOSED_MM = 1e-10
_MIN_SINE = 1e-3
_MAX_NEWTON_STEPS = 20


class JammedError(Exception):
    """The joints ask for a place at which the moving triangle cannot be; the message names the joints."""


@dataclass(frozen=True, slots=True)
class MachineFlaws:
    """Errors of a machine, one sigma each: places and directions of rails and edges, screws, lost steps.

    A lost step is lost for good: the counter continues. ``lost_share`` is the share of all steps.
    """

    place_mm: float = 0.0
    direction_deg: float = 0.0
    screw_ppm: float = 0.0
    lost_share: float = 0.0


@dataclass(slots=True)
class DoubleTriangle:
    """A machine with its joints at ``joints_mm`` and its moving triangle at ``pose`` (a mm, b mm, φ rad).

    ``fixed_mm`` and ``moving_mm`` (3, 2) are the triangles' vertices; side i connects the vertices i and
    i + 1, and point i is driven along side i of the fixed triangle and guides side i of the moving one.
    """

    fixed_mm: Array
    moving_mm: Array
    pose: Array
    flaws: MachineFlaws = field(default_factory=MachineFlaws)
    seed: int = 0
    joints_mm: Array = field(init=False)
    _rails: list[tuple[Array, Array]] = field(init=False)
    _edges: list[tuple[Array, Array]] = field(init=False)
    _travel_mm: Array = field(init=False)
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.seed, 23])
        flaws, rng = self.flaws, self._rng
        self._rails = [self._side(self.fixed_mm, k) for k in range(3)]
        self._edges = [self._side(self.moving_mm, k) for k in range(3)]
        scale = 1.0 + 1e-6 * flaws.screw_ppm * rng.normal(size=3)
        self._rails = [(at, along * factor) for (at, along), factor in zip(self._rails, scale, strict=True)]
        self._travel_mm = self._crossings()
        self.joints_mm = STEP_MM * np.round(self._travel_mm / STEP_MM)
        self._travel_mm = self.joints_mm.copy()
        self._close()

    def move(self, joints_mm: Array) -> None:
        """Drive the joints (3,) to the nearest steps. Raises JammedError on the way, and stays there."""
        wanted = STEP_MM * np.round(np.asarray(joints_mm, float) / STEP_MM)
        steps = np.round((wanted - self.joints_mm) / STEP_MM).astype(int)
        lost = self._rng.binomial(np.abs(steps), self.flaws.lost_share) * np.sign(steps)
        start, end = self._travel_mm.copy(), self._travel_mm + STEP_MM * (steps - lost)
        strides = max(1, math.ceil(float(np.max(np.abs(end - start))) / _STRIDE_MM))
        for k in range(1, strides + 1):
            before, at = self.pose.copy(), self._travel_mm.copy()
            self._travel_mm = start + (end - start) * k / strides
            try:
                self._close()
            except JammedError:
                self.pose, self._travel_mm = before, at
                raise
        self.joints_mm = wanted

    def _side(self, vertices: Array, k: int) -> tuple[Array, Array]:
        """A point and the unit direction of a side, with its errors."""
        span = vertices[(k + 1) % 3] - vertices[k]
        angle = math.atan2(span[1], span[0])
        angle += math.radians(self.flaws.direction_deg) * self._rng.normal()
        place = vertices[k] + self.flaws.place_mm * self._rng.normal(size=2)
        return place, np.array([math.cos(angle), math.sin(angle)])

    def _placed(self, k: int) -> tuple[Array, Array]:
        """A point and the direction of edge k in the fixed frame."""
        a, b, phi = self.pose
        turn = np.array([[math.cos(phi), -math.sin(phi)], [math.sin(phi), math.cos(phi)]])
        at, along = self._edges[k]
        return turn @ at + (a, b), turn @ along

    def _crossings(self) -> Array:
        """Travels (3,) at which the edges cross the rails in the pose."""
        travels = []
        for k, (start, along) in enumerate(self._rails):
            at, edge = self._placed(k)
            system = np.column_stack([along, -edge])
            if abs(np.linalg.det(system)) < _MIN_SINE:
                raise JammedError(f"edge {k + 1} is parallel to its rail")
            travels.append(float(np.linalg.solve(system, at - start)[0]))
        return np.array(travels)

    def _close(self) -> None:
        """Find the pose next to the present one in which every driven point is on its edge (Newton)."""
        for _ in range(_MAX_NEWTON_STEPS):
            gaps, slopes = np.empty(3), np.empty((3, 3))
            for k, (start, along) in enumerate(self._rails):
                at, edge = self._placed(k)
                across = np.array([-edge[1], edge[0]])
                lever = start + self._travel_mm[k] * along - at
                gaps[k] = across @ lever
                # A turn about the origin of the EE moves the edge's point, too.
                arm = start + self._travel_mm[k] * along - self.pose[:2]
                slopes[k] = (-across[0], -across[1], -(edge @ arm))
            try:
                change = np.linalg.solve(slopes, -gaps)
            except np.linalg.LinAlgError:
                break
            if abs(change[2]) > 0.1:
                break
            self.pose = self.pose + change
            if np.max(np.abs(gaps)) < _CLOSED_MM:
                return
        joints = ", ".join(f"{value:.3f}" for value in self._travel_mm)
        raise JammedError(f"the moving triangle cannot follow the joints at {joints} mm")
