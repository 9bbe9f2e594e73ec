"""Alignment of an inclinometer's axes to the unit, from readings in known positions. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.records import FloatArray

ZERO_DEG, ASKEW_DEG = 20.0, 2.0
"""Standard uncertainty before any reading: of an axis' zero, and of its turn about the vertical, degrees."""
_STEPS = 8
"""Steps of the iterations: each is 10 times as accurate as the one before for zeros of 5°."""
_STEP = 1e-6
"""Step of the differences: sines of angles, and radians."""


@dataclass(frozen=True, slots=True)
class Tilt:
    """Roll and pitch of the unit against gravity, degrees, with their standard uncertainties.

    ``pitch_deg`` is 0 where the sensor has one axis.
    """

    roll_deg: float
    pitch_deg: float
    sigma_roll_deg: float
    sigma_pitch_deg: float


@dataclass(frozen=True, slots=True)
class Position:
    """The sensor's mean angles, degrees, with the unit on a plate, turned about the plate's normal.

    ``plate_deg`` is the stated roll and pitch of a unit that is not turned. Positions with the same one are
    on the same plate: its error is the same in all of them. ``turned_deg`` is counterclockwise as seen from
    above, ``sigma_deg`` the standard uncertainty of the mean angles, the second one None with one axis.
    """

    plate_deg: tuple[float, float]
    turned_deg: float
    angles_deg: tuple[float, float | None]
    sigma_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Directions of a sensor's two axes in the unit.

    The first axis is (1, a, b), the second (c, d, 1) in the unit's frame, x to the right, y up, z along the
    beam, up to their length: ``axes`` (4,) is a, b, c, d and ``covariance`` (4, 4) theirs. Their zeros are a
    and d; b and c are turns about the vertical, one of each axis, for they need not be perpendicular. An axis
    measures the sine of its inclination. ``roll_is_inclination`` is as in ``InclinometerAccuracy``,
    ``temperature_c`` the sensor's temperature in the positions.
    """

    axes: FloatArray
    covariance: FloatArray
    roll_is_inclination: bool
    temperature_c: float

    def tilt(self, roll_deg: float, pitch_deg: float | None, sigma_deg: float) -> Tilt:
        """Return the unit's tilt from angles of the sensor, whose standard uncertainty is ``sigma_deg``."""
        angles_deg = np.array([roll_deg, pitch_deg or 0.0])
        at = np.concatenate([self.axes, np.radians(angles_deg)])
        both = np.array([self._tilt_rad(at + step) for step in (*(_STEP * np.eye(6)), np.zeros(6))])
        gradient = (both[:-1] - both[-1]) / _STEP
        covariance = np.zeros((6, 6))
        covariance[:4, :4] = self.covariance
        covariance[4, 4] = math.radians(sigma_deg) ** 2
        if pitch_deg is not None:
            covariance[5, 5] = covariance[4, 4]
        sigmas = np.degrees(np.sqrt(np.einsum("ik,ij,jk->k", gradient, covariance, gradient)))
        roll, pitch = np.degrees(both[-1])
        return Tilt(float(roll), float(pitch), float(sigmas[0]), float(sigmas[1]))

    def _tilt_rad(self, at: FloatArray) -> FloatArray:
        """Roll and pitch (2,) for axes and angles (6,), rad: the vertical u with axis · u = sine, |u| = 1."""
        axes, along = _directions(at[:4]), _sines(at[4:], self.roll_is_inclination)
        beside = np.linalg.inv(axes[:, ::2])
        fixed, per_height = beside @ along, -beside @ axes[:, 1]
        height = 1.0
        for _ in range(_STEPS):
            x, z = fixed + per_height * height
            height = math.sqrt(max(1.0 - x**2 - z**2, 0.0))
        return np.array([math.atan2(-x, height), math.asin(min(max(z, -1.0), 1.0))])


def _directions(axes: FloatArray) -> FloatArray:
    """Directions (2, 3) of the two axes in the unit, of length 1."""
    both = np.array([[1.0, axes[0], axes[1]], [axes[2], axes[3], 1.0]])
    directions: FloatArray = both / np.linalg.norm(both, axis=1)[:, None]
    return directions


def _sines(angles_rad: FloatArray, roll_is_inclination: bool) -> FloatArray:
    """Components (2,) of the vertical along the two axes; roll is clockwise, so its axis then points down."""
    roll, pitch = angles_rad
    across = 1.0 if roll_is_inclination else math.cos(pitch)
    return np.array([-math.sin(roll) * across, math.sin(pitch)])


def vertical(roll_deg: float, pitch_deg: float) -> FloatArray:
    """Return the vertical (3,) in the frame of a unit with this roll and pitch."""
    roll, pitch = math.radians(roll_deg), math.radians(pitch_deg)
    return np.array([-math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch), math.sin(pitch)])


def align(
    positions: Sequence[Position], plate_sigma_deg: float, roll_is_inclination: bool, temperature_c: float
) -> tuple[Alignment, float]:
    """Return the alignment from positions, and their largest deviation from it in standard deviations.

    Least squares with the sensor's angles, the plates' stated tilts (``plate_sigma_deg``, each of roll and
    pitch) and ``ZERO_DEG`` and ``ASKEW_DEG`` as observations. Two positions that differ by 180° on one plate
    show the zeros, whatever the plate's tilt; positions with a known tilt the turns about the vertical.
    What the positions do not show keeps its uncertainty.
    """
    plates = sorted({each.plate_deg for each in positions})
    before = np.concatenate(
        [
            np.radians([ZERO_DEG, ASKEW_DEG, ASKEW_DEG, ZERO_DEG]),
            np.full(2 * len(plates), math.radians(plate_sigma_deg)),
        ]
    )
    measured = np.array(
        [
            value
            for each in positions
            for value in _sines(
                np.radians([each.angles_deg[0], each.angles_deg[1] or 0.0]), roll_is_inclination
            )
        ]
    )
    weights = np.array(
        [
            1.0 / math.radians(each.sigma_deg) if angle is not None else 0.0
            for each in positions
            for angle in each.angles_deg
        ]
    )

    def model(at: FloatArray) -> FloatArray:
        axes, found = _directions(at[:4]), []
        for each in positions:
            first = 4 + 2 * plates.index(each.plate_deg)
            errors_deg = np.degrees(at[first : first + 2])
            up = vertical(*(np.array(each.plate_deg) + errors_deg))
            turn = math.radians(each.turned_deg)
            x, z = up[0], up[2]
            turned = [x * math.cos(turn) + z * math.sin(turn), up[1], z * math.cos(turn) - x * math.sin(turn)]
            found.append(axes @ turned)
        return np.concatenate(found)

    at = np.zeros(len(before))
    for _ in range(_STEPS):
        now = model(at)
        slope = np.array([(model(at + step) - now) / _STEP for step in _STEP * np.eye(len(at))]).T
        normal = (slope.T * weights**2) @ slope + np.diag(before**-2.0)
        at = at + np.linalg.solve(normal, slope.T @ (weights**2 * (measured - now)) - at / before**2)
    covariance: FloatArray = np.linalg.inv(normal)[:4, :4]
    deviations = np.concatenate([weights * (measured - model(at)), at[4:] / before[4:]])
    return Alignment(at[:4], covariance, roll_is_inclination, temperature_c), float(np.abs(deviations).max())
