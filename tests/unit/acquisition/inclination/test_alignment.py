"""Axes of an inclinometer from positions, against units that are turned by matrices."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from altd.acquisition.inclination.alignment import Alignment, Position, align

LIMIT_DEG, PLATE_DEG = 0.01, 0.005
PLANS = {
    "two": ((0, 0, 0), (0, 0, 180)),
    "four": ((0, 0, 0), (0, 0, 180), (10, 0, 0), (0, 10, 0)),
    "one plate": ((10, 0, 0), (10, 0, 90), (10, 0, 180), (10, 0, 270)),
}
Array = np.ndarray
Read = Callable[[Array], tuple[float, float]]


def frame_of(roll_deg: float, pitch_deg: float) -> Array:
    """A unit's x, y and z in the world (right, up, ahead): it pitches, then rolls clockwise about its z."""
    pitch, roll = math.radians(pitch_deg), math.radians(roll_deg)
    ahead = np.array([0.0, math.sin(pitch), math.cos(pitch)])
    right = np.array([1.0, 0.0, 0.0])
    up = np.array([0.0, math.cos(pitch), -math.sin(pitch)])
    return np.array(
        [right * math.cos(roll) - up * math.sin(roll), up * math.cos(roll) + right * math.sin(roll), ahead]
    )


def turned(frame: Array, turned_deg: float) -> Array:
    """The unit turned about its own y, counterclockwise as seen from above: x goes where z was."""
    turn = math.radians(turned_deg)
    x, y, z = frame
    return np.array([x * math.cos(turn) + z * math.sin(turn), y, z * math.cos(turn) - x * math.sin(turn)])


def sensor(rng: np.random.Generator, roll_is_inclination: bool, zero_deg: float = 1.5) -> Read:
    """A sensor whose axes are askew by some 1°, with zeros; its errors are uniform within the limit."""
    askew, zero = math.radians(1.0), math.radians(zero_deg)
    a, d = rng.normal(0.0, zero, 2)
    b, c = rng.normal(0.0, askew, 2)
    axes = np.array([[1.0, a, b], [c, d, 1.0]])
    axes /= np.linalg.norm(axes, axis=1)[:, None]

    def read(frame: Array) -> tuple[float, float]:
        across, along = axes @ frame[:, 1]
        pitch = math.asin(along)
        roll = math.asin(-across / (1.0 if roll_is_inclination else math.cos(pitch)))
        first, second = np.degrees([roll, pitch]) + rng.uniform(-LIMIT_DEG, LIMIT_DEG, 2)
        return float(first), float(second)

    return read


def levelled(
    rng: np.random.Generator, read: Read, plan: Sequence[tuple[float, float, float]], is_inclination: bool
) -> tuple[Alignment, float]:
    errors: dict[tuple[float, float], Array] = {}
    positions = []
    for roll_deg, pitch_deg, turned_deg in plan:
        error = errors.setdefault((roll_deg, pitch_deg), rng.normal(0.0, PLATE_DEG, 2))
        frame = turned(frame_of(roll_deg + error[0], pitch_deg + error[1]), turned_deg)
        positions.append(Position((roll_deg, pitch_deg), turned_deg, read(frame), LIMIT_DEG / math.sqrt(3.0)))
    return align(positions, PLATE_DEG, is_inclination, 20.0)


@pytest.mark.parametrize("is_inclination", [False, True])
@pytest.mark.parametrize(
    ("plan", "least", "most_deg"), [("two", 0.3, 0.4), ("four", 0.8, 0.02), ("one plate", 0.8, 0.02)]
)
def test_errors_are_as_large_as_sigma_says(
    plan: str, least: float, most_deg: float, is_inclination: bool
) -> None:
    """Two positions show the zeros alone: sigma then has 2° for each axis, of which 1° is drawn."""
    rng = np.random.default_rng(7)
    off, sigmas = [], []
    for _ in range(60):
        read = sensor(rng, is_inclination)
        alignment, deviation = levelled(rng, read, PLANS[plan], is_inclination)
        assert deviation < 5.0
        roll_deg, pitch_deg = rng.uniform(-8.0, 8.0, 2)
        tilt = alignment.tilt(*read(frame_of(roll_deg, pitch_deg)), LIMIT_DEG / math.sqrt(3.0))
        sigmas.append((tilt.sigma_roll_deg, tilt.sigma_pitch_deg))
        off.append((tilt.roll_deg - roll_deg, tilt.pitch_deg - pitch_deg))
    rms = np.sqrt(np.mean(np.square(np.array(off) / np.array(sigmas)), axis=0))
    assert ((least < rms) & (rms < 1.25)).all(), rms
    assert np.max(sigmas) <= most_deg


def test_a_unit_turned_the_other_way_contradicts_itself() -> None:
    rng = np.random.default_rng(8)
    read = sensor(rng, True)
    plan = [(roll, pitch, -turn) for roll, pitch, turn in PLANS["one plate"]]
    positions = [
        Position((roll, pitch), -turn, read(turned(frame_of(roll, pitch), turn)), 0.006)
        for roll, pitch, turn in plan
    ]
    assert align(positions, PLATE_DEG, True, 20.0)[1] > 5.0


def test_one_axis_has_a_zero_alone() -> None:
    rng = np.random.default_rng(9)
    read = sensor(rng, False, zero_deg=0.0)
    positions = [
        Position((0.0, 0.0), turn, (read(turned(frame_of(0.3, 0.0), turn))[0] + 1.2, None), 0.006)
        for turn in (0.0, 180.0)
    ]
    alignment, _ = align(positions, 0.5, False, 20.0)
    tilt = alignment.tilt(4.2, None, 0.006)
    assert tilt.roll_deg == pytest.approx(3.0, abs=0.02)
    assert 0.005 < tilt.sigma_roll_deg < 0.02
