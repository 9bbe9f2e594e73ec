"""Printed targets of any lattice before the simulator's camera; their truth is what they are made of."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from altd.calibration.printed.lattice import Lattice, find_lattice
from altd.calibration.printed.sample import PolynomialInverse, sample_of
from altd.mapping.grid import convex_hull_mm
from altd.mapping.tensor_map import TensorMap, fit_tensor_map
from altd.records import Frame
from altd.vision.settings import SpotSettings
from hw_sim.assembly import FRONT_FOCAL_MM, make_lens
from hw_sim.beam import BeamPose, Laser, footprint
from hw_sim.imager import Imager, Settings
from hw_sim.scan import Grid
from hw_sim.sensor import Sensor
from hw_sim.targets import soft_disc
from hw_sim.view import View, make_view

NODES_MM = np.array(Grid().nodes_mm())


@dataclass(frozen=True)
class Dots:
    """A print of round dots: steps from dot to dot (2, 2) mm, one a row; ``bend`` moves what is printed."""

    steps_mm: np.ndarray
    radius_mm: float
    phase_mm: tuple[float, float] = (0.2, 0.3)
    bend: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]] = field(
        default=lambda x, y: (np.zeros_like(x), np.zeros_like(y))
    )

    def cover(self, x_mm: np.ndarray, y_mm: np.ndarray, softness_mm: float) -> np.ndarray:
        moved_x, moved_y = self.bend(x_mm, y_mm)
        x, y = x_mm - moved_x - self.phase_mm[0], y_mm - moved_y - self.phase_mm[1]
        to_steps = np.linalg.inv(self.steps_mm)
        a, b = (x * to_steps[0, n] + y * to_steps[1, n] for n in (0, 1))
        nearest = np.full_like(x, np.inf)
        for down in (0, 1):
            for right in (0, 1):
                of_a, of_b = a - np.floor(a) - right, b - np.floor(b) - down
                dx, dy = (of_a * self.steps_mm[0, n] + of_b * self.steps_mm[1, n] for n in (0, 1))
                nearest = np.minimum(nearest, np.hypot(dx, dy))
        return soft_disc(nearest.astype(np.float32), self.radius_mm, softness_mm)


def steps(pitch_mm: float, angle_deg: float, turn_deg: float, ratio: float = 1.0) -> np.ndarray:
    """Two steps of ``pitch_mm`` (the second ``ratio`` times as long) with an angle between them."""
    first, second = np.radians([turn_deg, turn_deg + angle_deg])
    along = [np.cos(first), np.sin(first)]
    return pitch_mm * np.array([along, [ratio * np.cos(second), ratio * np.sin(second)]])


class Scene:
    """One camera in front of one target, printed or plain."""

    def __init__(self, dots: Dots | None, speckle: float = 0.1, seed: int = 1, power_mw: float = 3.0) -> None:
        rng = np.random.default_rng(seed)
        self.lens = make_lens(FRONT_FOCAL_MM, mirrored=True, rng=rng)
        self.view: View = make_view(self.lens, dots, speckle, 20, rng)
        self.imager = Imager(self.view, Sensor(8), Settings(1.6), lux=200.0)
        self.laser = Laser(power_mw=power_mw)
        self._rng = rng

    def frame(self, x_mm: float, y_mm: float) -> Frame:
        spot = footprint(self.laser, BeamPose(x_mm, y_mm), 0.0)
        noise = self._rng.standard_normal(self.view.response.shape, dtype=np.float32)
        return Frame("front", 0, 0, self.imager.expose_from_pool([spot], False, noise), 8)

    def frames(self) -> list[Frame]:
        return [self.frame(x, y) for x, y in NODES_MM]

    def nodes_px(self) -> np.ndarray:
        return np.stack(self.lens.project(*NODES_MM.T), axis=1)

    def first_map(self) -> TensorMap:
        """A polynomial through the nodes; its misses are far below a dot's pitch."""
        return fit_tensor_map(NODES_MM, self.nodes_px(), convex_hull_mm(NODES_MM), (3, 3)).map


def lattice_of(scene: Scene) -> Lattice | None:
    """The measured lattice of a print."""
    plane = PolynomialInverse(scene.first_map())
    samples = [sample_of(frame, plane, SpotSettings(), None) for frame in scene.frames()]
    seen = [sample for sample in samples if sample is not None]
    assert len(seen) == len(NODES_MM)
    return find_lattice(seen, plane.to_mm(scene.nodes_px()))
