"""Measured and known beams of a verification, and the covariance of what the unit states of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.instruments.beam.solver import line_gain
from altd.measuring.calibration import Calibration
from altd.records import FloatArray, Measurement

KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
"""The columns of a set's values."""

PATTERN_MM = 4.0
"""Distance over which print and speckle lose their correlation: a third of a usual spot's 1/e² diameter.

The pattern is the same whenever the spot returns to a place, so repeated positions are not independent.
"""


@dataclass(frozen=True, slots=True, eq=False)
class BeamSet:
    """Valid measurements made without touching the mounting of stage and unit.

    ``known_mm`` (n, 2) are the stage's positions, ``values`` (n, 4) the measured ones by ``KEYS`` and
    ``sigma`` (n, 4) the part of their stated uncertainty that
    scatters. ``map_factor`` (n, 4, m) is the part of them that the
    maps have in common: each of the m columns is one independent error of 1 sigma. ``turned``: the unit was
    turned by 180° about its z axis. ``stage_mm`` is the reference's positioning, 1 sigma per axis.
    """

    known_mm: FloatArray
    values: FloatArray
    sigma: FloatArray
    map_factor: FloatArray
    turned: bool
    stage_mm: float

    def __len__(self) -> int:
        return len(self.known_mm)


def beam_set(
    calibration: Calibration,
    measurements: Sequence[Measurement],
    known_mm: FloatArray,
    turned: bool,
    stage_mm: float,
) -> BeamSet:
    """The set of valid measurements of this calibration at known positions (n, 2)."""
    values = np.array([[each.values[key].value for key in KEYS] for each in measurements])
    sigma = np.array([[each.sigma_random(key) or 0.0 for key in KEYS] for each in measurements])
    return BeamSet(
        known_mm.reshape(-1, 2),
        values.reshape(-1, 4),
        sigma.reshape(-1, 4),
        _map_factor(calibration, measurements),
        turned,
        stage_mm,
    )


def _map_factor(calibration: Calibration, measurements: Sequence[Measurement]) -> FloatArray:
    """The errors (n, 4, m) of the values that the coefficients' covariance leaves, by Eq. 3.49-3.53."""
    count = len(measurements)
    gain, _ = line_gain([target.z_mm for target in calibration.targets], np.eye(2 * len(calibration.targets)))
    of_targets = []
    for index, target in enumerate(calibration.targets):
        values = [each.targets[target.name] or {} for each in measurements]
        points_mm = np.array([[of["x_mm"].value, of["y_mm"].value] for of in values]).reshape(-1, 2)
        errors_mm = np.linalg.solve(target.map.jacobian(points_mm), target.map.errors_px(points_mm))
        of_line = gain[:, 2 * index : 2 * index + 2]  # x, slope x, y, slope y
        of_targets.append(np.einsum("ij,njm->nim", of_line, errors_mm))
    factor = np.concatenate(of_targets, axis=2)[:, [0, 2, 1, 3]]
    for column in (2, 3):
        angle_deg = np.array([each.values[KEYS[column]].value for each in measurements]).reshape(count, 1)
        factor[:, column] *= math.degrees(1.0) * np.cos(np.radians(angle_deg)) ** 2
    result: FloatArray = factor
    return result


def joint_covariance(sets: Sequence[BeamSet], columns: tuple[int, int], with_stage: bool) -> FloatArray:
    """Covariance (2 N, 2 N) of two columns of all N measurements, the first column's N rows first.

    The maps' errors are common to all. The rest is a pattern that returns with the place. The stage's
    positioning is independent from one measurement to the next.
    """
    places_mm = np.concatenate([one.values[:, :2] for one in sets])
    squared_mm2 = np.square(places_mm[:, None] - places_mm[None]).sum(axis=2)
    likeness = np.exp(-squared_mm2 / (2 * PATTERN_MM**2))
    count = len(places_mm)
    factor = np.concatenate([np.concatenate([one.map_factor[:, c] for one in sets]) for c in columns])
    covariance: FloatArray = factor @ factor.T
    stage_mm2 = np.concatenate([np.full(len(one), one.stage_mm**2) for one in sets])
    for number, column in enumerate(columns):
        block = slice(number * count, (number + 1) * count)
        stated = np.concatenate([one.sigma[:, column] for one in sets]) ** 2
        own = np.sqrt(np.maximum(stated - np.square(factor[block]).sum(axis=1), 0.0))
        covariance[block, block] += likeness * np.outer(own, own)
        if with_stage:
            covariance[block, block] += np.diag(stage_mm2)
    return covariance
