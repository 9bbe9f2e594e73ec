"""A machine that moves as the simulator says, measured without pictures.

The spots of known beams through straight maps, with noise and with an error of the map that stays while the
machine moves.
"""

import math
from dataclasses import replace

import numpy as np

from altd.config import Installation, Measuring
from altd.measuring.spot_locator import Located
from altd.records import Measurement, Spot
from hw_sim.beam import BeamPose
from hw_sim.motion import Drive, Oscillation, Vibration, make_path, make_vibration
from support import evidence
from support.located import located, paired
from support.measurements import beam_chain

KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
PERIOD_NS = 50_000_000
NOISE_PX, MAP_PX = 0.02, math.hypot(0.03, 0.01)


class Machine:
    """A beam on a path of the simulator, and what two cameras see of it."""

    def __init__(self, seed: int, *motions: Oscillation) -> None:
        self._rng = np.random.default_rng(seed)
        self._motions = motions
        self._map_error_px = self._rng.normal(0.0, MAP_PX, (2, 2))

    def pose(self, t_ns: int) -> BeamPose:
        pose = BeamPose(5.0, -3.0, 0.01, 0.02)
        for motion in self._motions:
            pose = motion.moved(pose, t_ns)
        return pose

    def truth(self, t_ns: int) -> np.ndarray:
        pose = self.pose(t_ns)
        return np.array([pose.x_mm, pose.y_mm, pose.yaw_deg, pose.pitch_deg])

    def measured(
        self, numbers: range | list[int], measuring: Measuring, installation: Installation | None = None
    ) -> list[Measurement]:
        chain = beam_chain(evidence.calibration(), measuring, installation)
        measurements: list[Measurement] = []
        for number in numbers:
            t_ns = number * PERIOD_NS
            seen: list[Located] = []
            for row, (name, z_mm) in enumerate((("front", 0.0), ("rear", evidence.DISTANCE_MM))):
                px = evidence.straight_px(name, np.array([self.pose(t_ns).at(z_mm)]))[0]
                u, v = px + self._map_error_px[row] + self._rng.normal(0.0, NOISE_PX, 2)
                spot = Spot(float(u), float(v), NOISE_PX, 40.0, 200.0)
                seen.append(replace(located(name, number, t_ns), spot=spot))
            measurement = chain.add(paired(*seen))
            measurements += [measurement] if measurement else []
        return measurements


def machine(seed: int, speed_mm_per_s: float, *, vibrates: bool) -> Machine:
    rng = np.random.default_rng([seed, 1])
    motions = []
    if speed_mm_per_s:
        drive = Drive()
        motions.append(make_path(replace(drive, period_s=2 * math.pi * drive.x_mm / speed_mm_per_s), rng))
    if vibrates:
        motions.append(make_vibration(Vibration(), rng))
    return Machine(seed, *motions)
