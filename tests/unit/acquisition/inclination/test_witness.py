"""Gravity as a witness: a beam that stays in the world while machine and sensor move, and one that moves."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from altd.acquisition.inclination.witness import Witness, inclination
from altd.records import Value

S = 1_000_000_000
BEAM_DEG, SURVEY_DEG, SENSOR_DEG, ZERO_DEG = 0.004, 0.002, 0.01, 0.005
"""Of the beam's pitch and the survey (1 sigma), the sensor's limit, its zero after levelling (1 sigma)."""
SIGMAS = 3.0


@dataclass
class World:
    """A machine that drives along a beam, rising by 0.5°; its errors are drawn once."""

    seed: int
    vibration_deg: float = 0.02

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.zero_deg = self.rng.normal(0.0, ZERO_DEG, 2)
        self.beam_zero_deg, self.survey_deg = self.rng.normal(0.0, (BEAM_DEG, SURVEY_DEG))
        self.drift_deg_per_k = self.rng.uniform(-0.0005, 0.0005)
        self.phase = self.rng.uniform(0.0, 2.0 * math.pi, 4)

    def sample(self, t_s: float, off_deg: float = 0.0):
        """As unit and sensor see it at that time, with the beam off vertically."""
        hour = t_s / 3600.0
        roll_deg = 4.0 * math.sin(hour / 3.0 + self.phase[0])
        pitch_deg = 5.0 * math.sin(hour / 5.0 + self.phase[1])
        yaw_deg = 4.0 * math.sin(hour / 4.0 + self.phase[2])
        shaking_deg = self.rng.normal(0.0, self.vibration_deg / math.sqrt(20.0))
        roll, pitch, yaw = np.radians([roll_deg, pitch_deg + shaking_deg, yaw_deg])
        ahead = np.array([math.sin(yaw) * math.cos(pitch), math.sin(pitch), math.cos(yaw) * math.cos(pitch)])
        right = np.array([math.cos(yaw), 0.0, -math.sin(yaw)])
        up = np.cross(ahead, right)
        x, y = right * math.cos(roll) - up * math.sin(roll), up * math.cos(roll) + right * math.sin(roll)
        rise = math.radians(0.5 + off_deg)
        beam = np.array([0.0, math.sin(rise), math.cos(rise)])
        slope_x, slope_y = beam @ x / (beam @ ahead), beam @ y / (beam @ ahead)
        slope_y += math.radians(self.beam_zero_deg + self.rng.normal(0.0, 0.0005))
        warm_k = 20.0 * math.sin(hour / 6.0 + self.phase[3])
        errors_deg = self.zero_deg + self.drift_deg_per_k * warm_k
        errors_deg += SENSOR_DEG * np.sin(np.radians([roll_deg, pitch_deg]) * 40.0 + self.phase[:2])
        errors_deg += self.rng.normal(0.0, 0.003 / math.sqrt(7.0), 2)
        sensor_deg = math.sqrt((SENSOR_DEG**2 + (0.0005 * warm_k) ** 2) / 3.0)
        sigma_deg = math.hypot(sensor_deg, ZERO_DEG)
        unit = (
            Value(roll_deg + float(errors_deg[0]), sigma_deg),
            Value(pitch_deg + shaking_deg + float(errors_deg[1]), sigma_deg),
        )
        pitch_value = Value(math.degrees(math.atan(slope_y)), BEAM_DEG, 0.0005)
        return inclination(round(t_s * S), (slope_x, slope_y), pitch_value, unit, sensor_deg)

    def witness(self, is_stated: bool) -> Witness:
        return Witness(SIGMAS, Value(0.5 + self.survey_deg, SURVEY_DEG) if is_stated else None)


def is_away(witness: Witness, t_s: float) -> bool:
    found = witness.difference(round(t_s * S))
    return found is not None and witness.is_away(found)


@pytest.mark.long
@pytest.mark.parametrize("is_stated", [False, True])
def test_no_false_alarm_in_a_day_of_driving(is_stated: bool) -> None:
    world = World(1)
    witness = world.witness(is_stated)
    known = 0
    for t_s in range(0, 86_400, 2):
        witness.add(world.sample(t_s))
        if t_s % 10 == 0 and (found := witness.difference(t_s * S)) is not None:
            assert abs(found.value) < SIGMAS * (found.sigma or 0.0), (t_s, found)
            known += 1
    assert known > 8_500


@pytest.mark.parametrize("is_stated", [False, True])
@pytest.mark.parametrize("off_deg", [0.03, -0.03])
def test_a_beam_off_by_three_hundredths_is_reported_within_ten_seconds(
    is_stated: bool, off_deg: float
) -> None:
    found = 0
    for seed in range(20):
        world = World(seed)
        witness = world.witness(is_stated)
        for t_s in range(200):
            witness.add(world.sample(t_s))
        assert not is_away(witness, 200)
        for t_s in range(200, 210):
            witness.add(world.sample(t_s, off_deg))
        found += is_away(witness, 210)
    assert found == 20


def test_errors_are_as_large_as_sigma_says_with_a_stated_inclination() -> None:
    ratios = []
    for seed in range(200):
        world = World(seed)
        witness = world.witness(True)
        for t_s in range(6):
            witness.add(world.sample(t_s))
        found = witness.difference(6 * S)
        assert found is not None
        ratios.append(found.value / (found.sigma or 0.0))
    assert 0.7 < math.sqrt(sum(ratio**2 for ratio in ratios) / len(ratios)) < 1.25


def test_yaw_and_roll_are_no_divergence() -> None:
    """The sum of the two pitches would be off by 0.28° at 4° of each."""
    world = World(3, vibration_deg=0.0)
    world.zero_deg, world.beam_zero_deg, world.phase = np.zeros(2), 0.0, np.full(4, math.pi / 2)
    assert world.sample(0.0).value_deg == pytest.approx(0.5, abs=0.02)


def test_a_gap_forgets_the_reference_and_old_samples_tell_nothing() -> None:
    world = World(4)
    witness = world.witness(False)
    for t_s in range(700):
        witness.add(world.sample(t_s))
    assert witness.difference(700 * S) is not None
    assert witness.difference(706 * S) is None
    for t_s in range(1400, 1500):
        witness.add(world.sample(t_s, 2.0))
    found = witness.difference(1500 * S)
    assert found is not None, "the last minutes are known, the first ten not"
    for t_s in range(1500, 2005):
        witness.add(world.sample(t_s, 2.0))
    found = witness.difference(2005 * S)
    assert found is not None
    assert abs(found.value) < 0.03


def test_a_jump_does_not_count_as_usual_after_five_minutes() -> None:
    world = World(5)
    witness = world.witness(False)
    for t_s in range(200):
        witness.add(world.sample(t_s))
    for t_s in range(200, 1400):
        witness.add(world.sample(t_s, 0.05))
        assert t_s < 206 or is_away(witness, t_s), t_s
    for t_s in range(1400, 1420):
        witness.add(world.sample(t_s))
    assert not is_away(witness, 1420)
