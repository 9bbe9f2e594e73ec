"""The source's planar 3-PRP machine (§2.3.2): steppers move three points, the moving triangle follows.

The pose is found by following the closure of the mechanism from the current pose, as the real machine moves.
It therefore stays in its assembly mode, and jams where the closure has no further solution.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

STEP_MM = 0.025
"""Travel of one step: ball screws of 5 mm pitch, 200 steps a turn (§2.4.5)."""
_STRIDE_MM = 2.0
_CLOSED_MM = 1e-10
_MIN_SINE = 1e-3
_MAX_NEWTON_STEPS = 20


BASE_MM = 500.0
"""Short side of both triangles; the source states only the ratio 6 : 5."""
REST = (0.0, 700.0)
"""Position of the plate's origin in the fixed frame with the machine in the middle, as in Eq. 2.64."""
MAX_TRAVEL_MM = 60.0
"""Maximum travel of each joint from the middle for random poses, so that the plate stays in the picture."""
_MAX_DRAWS = 10_000


class JammedError(Exception):
    """The moving triangle cannot reach the requested joints; the message names them."""


@dataclass(frozen=True, slots=True)
class MachineFlaws:
    """Errors of a machine, 1 sigma each: positions and directions of rails and edges, screws, lost steps.

    A lost step is permanent: the counter continues. ``lost_share`` is the share of all steps.
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
        """Drive the joints (3,) to the nearest steps; raises JammedError, unmoved, if it would jam."""
        wanted = STEP_MM * np.round(np.asarray(joints_mm, float) / STEP_MM)
        steps = np.round((wanted - self.joints_mm) / STEP_MM).astype(int)
        lost = self._rng.binomial(np.abs(steps), self.flaws.lost_share) * np.sign(steps)
        before, start, end = self.pose, self._travel_mm, self._travel_mm + STEP_MM * (steps - lost)
        strides = max(1, math.ceil(float(np.max(np.abs(end - start))) / _STRIDE_MM))
        try:
            for k in range(1, strides + 1):
                self._travel_mm = start + (end - start) * k / strides
                self._close()
        except JammedError:
            self.pose, self._travel_mm = before, start
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
        """Travels (3,) at which the edges cross the rails in the current pose."""
        travels = list[float]()
        for k, (start, along) in enumerate(self._rails):
            at, edge = self._placed(k)
            system = np.column_stack([along, -edge])
            if abs(np.linalg.det(system)) < _MIN_SINE:
                raise JammedError(f"edge {k + 1} is parallel to its rail")
            travels.append(float(np.linalg.solve(system, at - start)[0]))
        return np.array(travels)

    def _close(self) -> None:
        """Find the pose nearest to the current one with every driven point on its edge (Newton)."""
        for _ in range(_MAX_NEWTON_STEPS):
            gaps, slopes = np.empty(3), np.empty((3, 3))
            for k, (start, along) in enumerate(self._rails):
                at, edge = self._placed(k)
                across = np.array([-edge[1], edge[0]])
                lever = start + self._travel_mm[k] * along - at
                gaps[k] = across @ lever
                # A turn about the origin of the EE also moves the edge's point.
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


def source_machine(flaws: MachineFlaws | None = None, seed: int = 0) -> DoubleTriangle:
    """The source's machine in the middle of its workspace; the plate's frame is that of its moving triangle.

    At φ = 0 the moving edges are parallel to the right leg, the left leg and the base of the fixed triangle:
    of all assignments only this one moves as Eq. 2.64.
    """
    height = math.sqrt((1.2 * BASE_MM) ** 2 - (BASE_MM / 2) ** 2)
    fixed = np.array([(0.0, 0.0), (BASE_MM, 0.0), (BASE_MM / 2, height)])
    moving = np.array([(0.0, 0.0), (BASE_MM / 2, -height), (BASE_MM, 0.0)])
    plate = moving.mean(axis=0)
    vertex = np.array([0.12 * BASE_MM, 0.5 * BASE_MM])  # position of the moving triangle in the fixed one
    shift = np.array(REST) - (vertex + plate)
    return DoubleTriangle(
        fixed + shift, moving - plate, np.array([*REST, 0.0]), flaws or MachineFlaws(), seed
    )


def random_motion(machine: DoubleTriangle, half_range: tuple[float, float, float]) -> Iterator[Array]:
    """Drive to random joints without end; yield true poses (a mm, b mm, φ °) up to ``half_range`` from rest.

    Joints at which the machine would jam are skipped.
    """
    middle = machine.joints_mm
    rng = np.random.default_rng([machine.seed, 25])
    for _ in range(_MAX_DRAWS):
        try:
            machine.move(middle + rng.uniform(-MAX_TRAVEL_MM, MAX_TRAVEL_MM, 3))
        except JammedError:
            continue
        pose = np.array([*machine.pose[:2], math.degrees(machine.pose[2])])
        if (np.abs(pose - (*REST, 0.0)) <= half_range).all():
            yield pose
    raise JammedError("no pose in the picture is reached")
