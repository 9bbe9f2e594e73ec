"""The example measurement on the pages of all interfaces, so that readers can compare them."""

import math
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta

import numpy as np

from altd.instruments.beam.instrument import QUANTITIES, values_of
from altd.instruments.beam.solver import Beam
from altd.ports import Clock, Stop
from altd.publish.serial.telegram import Nameplate
from altd.records import Measurement, Value
from altd.records.joint import Joint
from altd.records.spots import CrossCheckedBeam, CrossCheckedSpot, Motion
from altd.status.board import Board
from altd.status.health import Health
from altd.status.proof import Identity, Stamp, unit_number
from altd.status.unit import PublishedUnit, UnitView


def _motion(rate: float, sigma_rate: float, vibration: float, acceleration: float) -> Motion:
    return Motion(rate, sigma_rate, vibration, 0.0, 0.475, 0.0831, abs(rate), acceleration)


_BEAM = Beam(10.012, 4.987, 1.1459, -1.7184, 0.004, 0.004, 0.0011, 0.0011)
_ALIKE = np.eye(4)


def _joint() -> Joint:
    sigmas = np.array([_BEAM.sigma_x_mm, _BEAM.sigma_y_mm, _BEAM.sigma_yaw_deg, _BEAM.sigma_pitch_deg])
    correlation = np.eye(4)
    correlation[[0, 2], [2, 0]], correlation[[1, 3], [3, 1]] = -0.86, -0.83
    factors = np.array([1.0, 1.0, 1000 * math.radians(1), 1000 * math.radians(1)])
    covariance = correlation * np.outer(sigmas, sigmas)
    keys = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
    return Joint(keys, covariance, covariance / 4, factors, _ALIKE, _ALIKE, _ALIKE)


MEASURED = Measurement(
    sequence=160,
    t_ns=8_000_000_000,
    time=datetime(2026, 11, 20, 8, 15, 30, 125_000, UTC),
    frames=20,
    quantities=QUANTITIES,
    values=values_of(_BEAM),
    targets={
        "front": {"x_mm": Value(10.012), "y_mm": Value(4.987)},
        "rear": {"x_mm": Value(15.613), "y_mm": Value(-3.413)},
    },
    motions={
        "x_mm": _motion(0.0512, 0.0031, 0.0102, 0.004),
        "y_mm": _motion(-0.0214, 0.0031, 0.0094, 0.003),
        "yaw_deg": _motion(0.0021, 0.0004, 0.0012, 0.0002),
        "pitch_deg": _motion(0.0008, 0.0004, 0.0011, 0.0002),
    },
    joint=_joint(),
    cross_check=CrossCheckedBeam(
        1.1475,
        -1.7169,
        {
            "front": CrossCheckedSpot(334.952, 220.052, 10.009, 4.983),
            "rear": CrossCheckedSpot(437.452, 253.652, 15.618, -3.409),
        },
    ),
)

SERIAL = "ALT-0007"
AGE_S = 0.52
"""Age of the example when it is shown: time since the middle of its exposures, s."""
STAMP = Stamp(Identity(unit_number(SERIAL), 0x5C1E90A7), 4711, 345_678)
"""Stamp of the message in which the pages show the example."""
NAMEPLATE = Nameplate(unit=STAMP.identity.unit, serial=SERIAL, firmware="0.1.0", calibrated=date(2026, 11, 2))


class _Standing:
    """A clock that always reads ``AGE_S`` after the measurement."""

    def monotonic_ns(self) -> int:
        return MEASURED.t_ns + round(AGE_S * 1e9)

    def utc(self, t_ns: int) -> datetime | None:
        return (
            None
            if MEASURED.time is None
            else MEASURED.time + timedelta(microseconds=(t_ns - MEASURED.t_ns) / 1000)
        )

    async def sleep(self, seconds: float) -> None:
        return None

    def wait(self, stop: Stop, seconds: float) -> None:
        return None


def clock() -> Clock:
    """Clock at the moment of the example."""
    return _Standing()


def board() -> Board:
    """Board with the example measurement."""
    board = Board(clock(), 1.0, QUANTITIES, STAMP.identity)
    board.publish(MEASURED)
    return board


def view_of(
    measurement: Measurement | None = MEASURED,
    age_s: float | None = AGE_S,
    published: int = 1,
    stamp: Stamp | None = None,
) -> UnitView:
    """View of a unit that shows this measurement."""
    shown = PublishedUnit(board(), Health(clock())).view(stamp)
    return replace(shown, measurement=measurement, age_s=age_s, published=published)
