"""Least-squares fit of measured to known beams: scale, squareness, rotation, zero and scatter."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from altd.instruments.beam.solver import line_gain
from altd.measuring.calibration import Calibration
from altd.records import FloatArray, Measurement

KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
"""The columns of a set's values."""

PATTERN_MM = 4.0
"""Distance over which print and speckle lose their correlation: a third of a usual spot's 1/e² diameter.

The pattern recurs when the spot returns to a place, so repeated positions are not independent.
"""


@dataclass(frozen=True, slots=True, eq=False)
class BeamSet:
    """Valid measurements made without a change of the mounting of stage and unit.

    ``known_mm`` (n, 2) are the stage's positions, ``values`` (n, 4) the measured values by ``KEYS`` and
    ``sigma`` (n, 4) the random part of their stated uncertainty. ``map_factor`` (n, 4, m) is the part of it
    that is common through the maps: each of the m columns is one independent error of 1 sigma.
    ``turned``: whether the unit was turned by 180° about its z axis. ``stage_mm`` is the uncertainty of the
    reference's positioning, 1 sigma per axis.
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
    """Build the set of valid measurements of this calibration at known positions (n, 2)."""
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
    """Errors (n, 4, m) of the values by the covariance of the maps' coefficients, by Eq. 3.49-3.53."""
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

    The maps' errors are common to all. The rest is a pattern that recurs with the place. The stage's
    positioning errors are independent between measurements.
    """
    places_mm = np.concatenate([one.values[:, :2] for one in sets])
    squared_mm2 = np.square(places_mm[:, None] - places_mm[None]).sum(axis=2)
    correlation = np.exp(-squared_mm2 / (2 * PATTERN_MM**2))
    count = len(places_mm)
    factor = np.concatenate([np.concatenate([one.map_factor[:, c] for one in sets]) for c in columns])
    covariance: FloatArray = factor @ factor.T
    stage_mm2 = np.concatenate([np.full(len(one), one.stage_mm**2) for one in sets])
    for number, column in enumerate(columns):
        block = slice(number * count, (number + 1) * count)
        stated = np.concatenate([one.sigma[:, column] for one in sets]) ** 2
        own = np.sqrt(np.maximum(stated - np.square(factor[block]).sum(axis=1), 0.0))
        covariance[block, block] += correlation * np.outer(own, own)
        if with_stage:
            covariance[block, block] += np.diag(stage_mm2)
    return covariance


MAX_ROTATION_DEG = 10.0
"""Maximum rotation of a stage mounted by hand; more means other axes, or a wrong ``turned_deg``."""
MIN_POSITIONS = 5
"""Minimum number of valid positions: offset, rotation, scale and squareness take six of ten coordinates."""
_MIN_WIDTH_SHARE = 0.05
"""Minimum width of the positions' cloud over its length; narrower ones hardly separate scale and rotation."""


@dataclass(frozen=True, slots=True)
class Estimated:
    """A parameter, and its standard uncertainty by the uncertainties that the unit states."""

    value: float
    sigma: float


@dataclass(frozen=True, slots=True)
class Scatter:
    """An experimental standard deviation and the stated one.

    ``degrees_of_freedom`` are effective (Welch and Satterthwaite): measurements that share the map's errors
    or a place count less.
    """

    experimental: float
    stated: float
    degrees_of_freedom: float


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Errors of the unit and mounting of the sets.

    ``scale_ppm`` along x and y and ``square_mrad`` are errors of the unit's readings: positive if it reads
    too long, and if its axes enclose less than 90°. Per set: ``offsets_mm`` (k, 2), ``rotations_mrad``
    (k,), ``directions_deg`` (k, 2) as measured. ``zero_deg`` of yaw and pitch is the mean of both
    orientations; None without a turned set. Each unturned set is paired with one turned set, in the order in
    which they are given. ``upright_deg`` is the mean direction of the unturned sets. ``residuals`` are
    those of the fit, k arrays (n, 4).
    """

    scale_ppm: tuple[Estimated, Estimated]
    square_mrad: Estimated
    offsets_mm: FloatArray
    rotations_mrad: FloatArray
    directions_deg: FloatArray
    zero_deg: tuple[Estimated, Estimated] | None
    upright_deg: tuple[Estimated, Estimated] | None
    displacement: Scatter
    direction: Scatter
    residuals: tuple[FloatArray, ...]


def why_too_few(one: BeamSet) -> str:
    """Reason why a set is insufficient for an estimate; empty if it is sufficient."""
    if len(one) < MIN_POSITIONS:
        return f"too few positions: {len(one)} valid, at least {MIN_POSITIONS} are needed"
    along, across = np.linalg.svd(one.known_mm - one.known_mm.mean(axis=0), compute_uv=False)
    return "its positions are on one line" if across < _MIN_WIDTH_SHARE * along or along == 0.0 else ""


def why_not_aligned(one: BeamSet) -> str:
    """Complaint about a set whose stage has other axes than the unit; empty if the axes agree."""
    turn_deg = math.degrees(_turn_rad(one))
    if abs(turn_deg) <= MAX_ROTATION_DEG:
        return ""
    return (
        f"the measured positions are turned by {turn_deg:.0f}° against the known ones: check turned_deg and "
        "the stage's axes"
    )


def estimate(sets: Sequence[BeamSet]) -> Estimate:
    """Fit all sets together; ``why_too_few`` and ``why_not_aligned`` must be empty for each.

    The parameters are those of least squares weighted by the stated sigma. Their uncertainty and the degrees
    of freedom include all correlations.
    """
    turns = [_turn_rad(one) for one in sets]
    expected = [_turned(one, turn) for one, turn in zip(sets, turns, strict=True)]
    of_set = np.repeat(np.arange(len(sets)), [len(one) for one in sets])
    measured = np.concatenate([one.values for one in sets])
    known = np.concatenate(expected)
    displaced = _Fit.of(
        _design_displacement(known, of_set, len(sets)),
        (measured[:, :2] - known).T.ravel(),
        joint_covariance(sets, (0, 1), True),
    )
    directed = _Fit.of(
        np.asarray(np.kron(np.eye(2), _membership(of_set, len(sets))), dtype=np.float64),
        measured[:, 2:].T.ravel(),
        joint_covariance(sets, (2, 3), False),
    )
    upright = [number for number, one in enumerate(sets) if not one.turned]
    turned = [number for number, one in enumerate(sets) if one.turned]
    paired = list(itertools.chain.from_iterable(zip(upright, turned, strict=False)))
    per_set = displaced.parameters[3:].reshape(3, -1)
    residuals = np.column_stack([fit.residuals.reshape(2, -1).T for fit in (displaced, directed)])
    ends = np.cumsum([len(one) for one in sets])[:-1]
    return Estimate(
        (displaced.linear({0: 1.0}, 1e6), displaced.linear({1: 1.0}, 1e6)),
        displaced.linear({2: 1.0}, 1e3),
        per_set[:2].T,
        1e3 * (np.array(turns) + per_set[2]),
        directed.parameters.reshape(2, -1).T,
        _mean_direction(directed, len(sets), paired),
        _mean_direction(directed, len(sets), upright),
        displaced.scatter(),
        directed.scatter(),
        tuple(np.split(residuals, ends)),
    )


def _turn_rad(one: BeamSet) -> float:
    """Rotation of the measured against the known positions; 180° less for a turned unit."""
    known, measured = (
        complex_of - complex_of.mean()
        for complex_of in (_complex(one.known_mm) * _sign(one), _complex(one.values[:, :2]))
    )
    return float(np.angle(np.vdot(known, measured)))


def _turned(one: BeamSet, turn_rad: float) -> FloatArray:
    """Known positions (n, 2) in the directions of the unit's axes."""
    turned = _complex(one.known_mm) * _sign(one) * np.exp(1j * turn_rad)
    return np.column_stack([turned.real, turned.imag])


def _complex(points: FloatArray) -> npt.NDArray[np.complex128]:
    return points[:, 0] + 1j * points[:, 1]


def _sign(one: BeamSet) -> int:
    return -1 if one.turned else 1


def _membership(of_set: npt.NDArray[np.intp], count: int) -> FloatArray:
    """Matrix with 1 where a measurement (row) belongs to a set (column), else 0."""
    return np.eye(count)[of_set]


def _design_displacement(known_mm: FloatArray, of_set: npt.NDArray[np.intp], count: int) -> FloatArray:
    """Derivatives (2 N, 3 + 3 k): scale of x and y, squareness, then per set offset in x, in y, rotation."""
    x, y = known_mm.T[:, :, None]
    member = _membership(of_set, count)
    none, no_set = np.zeros_like(x), np.zeros_like(member)
    of_x = np.hstack([x, none, y / 2, member, no_set, -y * member])
    of_y = np.hstack([none, y, x / 2, no_set, member, x * member])
    return np.vstack([of_x, of_y])


def _mean_direction(directed: _Fit, count: int, numbers: Sequence[int]) -> tuple[Estimated, Estimated] | None:
    """Mean direction of the sets ``numbers`` of ``count``; None if there are none."""
    if not numbers:
        return None
    share = 1.0 / len(numbers)
    yaw = directed.linear(dict.fromkeys(numbers, share), 1.0)
    return yaw, directed.linear({count + number: share for number in numbers}, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Weighted least squares whose weights contain only the variances of a full covariance."""

    parameters: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    _degrees: float
    _ratio: float
    _stated: float

    @classmethod
    def of(cls, design: FloatArray, measured: FloatArray, covariance: FloatArray) -> _Fit:
        variances = np.diag(covariance)
        weights = 1.0 / variances
        weighted = design.T * weights
        solve = np.linalg.solve(weighted @ design, weighted)
        parameters = solve @ measured
        residuals = measured - design @ parameters
        leaves = np.eye(len(measured)) - design @ solve
        # E[Q] = tr(A V) and Var[Q] = 2 tr(A V A V) of the quadratic form Q = eᵀ A e
        shaped = (leaves.T * weights) @ leaves @ covariance
        mean = float(np.trace(shaped))
        square_sum = float(np.square(residuals) @ weights)
        return cls(
            parameters,
            solve @ covariance @ solve.T,
            residuals,
            mean**2 / float(np.einsum("ij,ji->", shaped, shaped)),
            float(np.sqrt(square_sum / mean)),
            float(np.sqrt(variances.mean())),
        )

    def linear(self, terms: dict[int, float], scale: float) -> Estimated:
        """Linear combination of parameters, times ``scale``."""
        row = np.zeros(len(self.parameters))
        row[list(terms)] = list(terms.values())
        sigma = float(np.sqrt(row @ self.covariance @ row))
        return Estimated(scale * float(row @ self.parameters), scale * sigma)

    def scatter(self) -> Scatter:
        return Scatter(self._ratio * self._stated, self._stated, self._degrees)
