"""Least-squares fit of measured to known beams: scale, squareness, rotation, zero and scatter."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

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


@dataclass(frozen=True, slots=True)
class Mounting:
    """Statements on a set, in the stage's axes.

    ``turned``: whether the unit was turned by 180° about its z axis. ``stage_mm`` is the uncertainty of the
    reference's positioning, ``seat_mm_per_m`` the scatter of the unit's z axis from one seating to the next,
    1 sigma per axis. ``deflection_deg`` is by how much the beam was deflected on purpose, in yaw and pitch,
    ``deflection_sigma_deg`` its standard uncertainty. None: not stated.
    """

    turned: bool = False
    stage_mm: float = 0.0
    seat_mm_per_m: float | None = None
    deflection_deg: tuple[float, float] = (0.0, 0.0)
    deflection_sigma_deg: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class BeamSet:
    """Valid measurements made without a change of the mounting of stage and unit.

    ``known_mm`` (n, 2) are the stage's positions, ``values`` (n, 4) the measured values by ``KEYS`` and
    ``sigma`` (n, 4) the random part of their stated uncertainty. ``map_factor`` (n, 4, m) is the part of it
    that is common through the maps: each of the m columns is one independent error of 1 sigma.
    ``distance_mm`` is the distance from the first to the last target.
    """

    known_mm: FloatArray
    values: FloatArray
    sigma: FloatArray
    map_factor: FloatArray
    distance_mm: float
    mounting: Mounting

    def __len__(self) -> int:
        return len(self.known_mm)

    @property
    def places_mm(self) -> tuple[FloatArray, FloatArray]:
        """Measured places (n, 2) on the first and on the last target."""
        first = self.values[:, :2]
        return first, first + self.distance_mm * np.tan(np.radians(self.values[:, 2:]))


def beam_set(
    calibration: Calibration, measurements: Sequence[Measurement], known_mm: FloatArray, mounting: Mounting
) -> BeamSet:
    """Build the set of valid measurements of this calibration at known positions (n, 2)."""
    values = np.array([[each.values[key].value for key in KEYS] for each in measurements])
    sigma = np.array([[each.sigma_random(key) or 0.0 for key in KEYS] for each in measurements])
    return BeamSet(
        known_mm.reshape(-1, 2),
        values.reshape(-1, 4),
        sigma.reshape(-1, 4),
        _map_factor(calibration, measurements),
        calibration.targets[-1].z_mm - calibration.targets[0].z_mm,
        mounting,
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


def joint_covariance(sets: Sequence[BeamSet], columns: tuple[int, int], is_direction: bool) -> FloatArray:
    """Covariance (2 N, 2 N) of two columns of all N measurements, the first column's N rows first.

    The maps' errors are common to all. The rest is a pattern that recurs with the place: of a displacement
    that on the first target, of a direction half of it each on the first and the last target. The stage's
    positioning errors are independent between measurements and do not change the direction.
    """
    first, last = (np.concatenate(places) for places in zip(*(one.places_mm for one in sets), strict=True))
    correlation = np.mean(
        [_recurrence(places) for places in ((first, last) if is_direction else (first,))], axis=0
    )
    count = len(first)
    factor = np.concatenate([np.concatenate([one.map_factor[:, c] for one in sets]) for c in columns])
    covariance: FloatArray = factor @ factor.T
    stage_mm2 = np.concatenate([np.full(len(one), one.mounting.stage_mm**2) for one in sets])
    for number, column in enumerate(columns):
        block = slice(number * count, (number + 1) * count)
        stated = np.concatenate([one.sigma[:, column] for one in sets]) ** 2
        own = np.sqrt(np.maximum(stated - np.square(factor[block]).sum(axis=1), 0.0))
        covariance[block, block] += correlation * np.outer(own, own)
        if not is_direction:
            covariance[block, block] += np.diag(stage_mm2)
    return covariance


def _recurrence(places_mm: FloatArray) -> FloatArray:
    """Correlation (n, n) of the pattern at places (n, 2)."""
    squared_mm2 = np.square(places_mm[:, None] - places_mm[None]).sum(axis=2)
    correlation: FloatArray = np.exp(-squared_mm2 / (2 * PATTERN_MM**2))
    return correlation


MAX_ROTATION_DEG = 10.0
"""Maximum rotation of a stage mounted by hand; more means other axes, or a wrong ``turned_deg``."""
MIN_POSITIONS = 5
"""Minimum number of valid positions: offset, rotation, scale and squareness take six of ten coordinates."""
_MIN_WIDTH_SHARE = 0.05
"""Minimum width of the positions' cloud over its length; narrower ones hardly separate scale and rotation."""


@dataclass(frozen=True, slots=True)
class Estimated:
    """A parameter, and its standard uncertainty by the uncertainties that the unit states.

    ``reference`` is the part of seat and deflection, which is not in ``sigma``; None: it is not stated.
    """

    value: float
    sigma: float
    reference: float | None = 0.0


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
    which they are given, without the deflected ones. ``upright_deg`` is the mean direction of the unturned
    sets. ``angle_scale_ppm`` of yaw and pitch compares each deflected set with the last one before it of its
    orientation without a deflection; None if there is none. ``distance_mm`` is the error of the distance
    of the targets, from the scales of displacement and of both angles. ``residuals`` are those of the fit, k
    arrays (n, 4).
    """

    scale_ppm: tuple[Estimated, Estimated]
    square_mrad: Estimated
    offsets_mm: FloatArray
    rotations_mrad: FloatArray
    directions_deg: FloatArray
    zero_deg: tuple[Estimated, Estimated] | None
    upright_deg: tuple[Estimated, Estimated] | None
    angle_scale_ppm: tuple[Estimated | None, Estimated | None]
    distance_mm: Estimated | None
    stated_distance_mm: float
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
    expected = [_rotated(one, one.known_mm, turn) for one, turn in zip(sets, turns, strict=True)]
    of_set = np.repeat(np.arange(len(sets)), [len(one) for one in sets])
    measured = np.concatenate([one.values for one in sets])
    known = np.concatenate(expected)
    displaced = WeightedFit.of(
        _design_displacement(known, of_set, len(sets)),
        (measured[:, :2] - known).T.ravel(),
        joint_covariance(sets, (0, 1), False),
    )
    directed = WeightedFit.of(
        np.asarray(np.kron(np.eye(2), _membership(of_set, len(sets))), dtype=np.float64),
        measured[:, 2:].T.ravel(),
        joint_covariance(sets, (2, 3), True),
    )
    straight = [number for number, one in enumerate(sets) if not any(one.mounting.deflection_deg)]
    upright = [number for number in straight if not sets[number].mounting.turned]
    turned = [number for number in straight if sets[number].mounting.turned]
    paired = list(itertools.chain.from_iterable(zip(upright, turned, strict=False)))
    scale = displaced.linear({0: 1.0}, 1e6), displaced.linear({1: 1.0}, 1e6)
    angle_scale = _angle_scale(directed, sets, turns, 0), _angle_scale(directed, sets, turns, 1)
    distance_mm = sets[0].distance_mm
    per_set = displaced.parameters[3:].reshape(3, -1)
    residuals = np.column_stack([fit.residuals.reshape(2, -1).T for fit in (displaced, directed)])
    ends = np.cumsum([len(one) for one in sets])[:-1]
    return Estimate(
        scale,
        displaced.linear({2: 1.0}, 1e3),
        per_set[:2].T,
        1e3 * (np.array(turns) + per_set[2]),
        directed.parameters.reshape(2, -1).T,
        _mean_direction(directed, sets, paired),
        _mean_direction(directed, sets, upright),
        angle_scale,
        _distance_error(scale, angle_scale, distance_mm),
        distance_mm,
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


def _rotated(one: BeamSet, vectors: FloatArray, turn_rad: float) -> FloatArray:
    """Vectors (n, 2) of the stage's axes in the directions of the unit's axes."""
    turned = _complex(vectors) * _sign(one) * np.exp(1j * turn_rad)
    return np.column_stack([turned.real, turned.imag])


def _complex(points: FloatArray) -> npt.NDArray[np.complex128]:
    return points[:, 0] + 1j * points[:, 1]


def _sign(one: BeamSet) -> int:
    return -1 if one.mounting.turned else 1


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


def _mean_direction(
    directed: WeightedFit, sets: Sequence[BeamSet], numbers: Sequence[int]
) -> tuple[Estimated, Estimated] | None:
    """Mean direction of the sets ``numbers``, with the scatter of their seatings; None if there are none."""
    if not numbers:
        return None
    share = 1.0 / len(numbers)
    seats = _if_all_stated([sets[number].mounting.seat_mm_per_m for number in numbers])
    reference = None if seats is None else share * math.degrees(1e-3 * math.hypot(*seats))
    yaw = directed.linear(dict.fromkeys(numbers, share), 1.0)
    pitch = directed.linear({len(sets) + number: share for number in numbers}, 1.0)
    return replace(yaw, reference=reference), replace(pitch, reference=reference)


def _angle_scale(
    directed: WeightedFit, sets: Sequence[BeamSet], turns_rad: Sequence[float], axis: int
) -> Estimated | None:
    """Error of the scale of yaw (``axis`` 0) or pitch (1), ppm, by the deflections in it.

    A slope too long by c makes an angle a too large by c · sin 2a / 2. The errors of all deflections are
    taken as one: one wedge or one circle makes them.
    """
    mountings = [one.mounting for one in sets]
    stated = [mounting.deflection_deg for mounting in mountings]
    known_deg = [
        _rotated(one, np.array([deflection]), turn)[0, axis]
        for one, deflection, turn in zip(sets, stated, turns_rad, strict=True)
    ]
    effects = np.degrees(np.sin(2 * np.radians(directed.parameters.reshape(2, -1)[axis])) / 2)
    row = np.zeros(len(sets))
    for number, mounting in enumerate(mountings):
        alike = [n for n in range(number) if mountings[n].turned is mounting.turned and not any(stated[n])]
        if alike and stated[number][axis]:
            row[[number, alike[-1]]] += (effects[number] - effects[alike[-1]]) * np.array([1.0, -1.0])
    if not row.any():
        return None
    row *= 1e6 / (row @ effects)
    found = directed.linear({axis * len(sets) + n: share for n, share in enumerate(row)}, 1.0)
    sigmas = _if_all_stated(
        [mounting.deflection_sigma_deg if any(mounting.deflection_deg) else 0.0 for mounting in mountings]
    )
    reference = None if sigmas is None else float(np.abs(row) @ sigmas)
    return Estimated(found.value - float(row @ known_deg), found.sigma, reference)


def _if_all_stated(values: Sequence[float | None]) -> list[float] | None:
    stated = [value for value in values if value is not None]
    return stated if len(stated) == len(values) else None


def _distance_error(
    scale_ppm: Sequence[Estimated], angle_scale_ppm: Sequence[Estimated | None], distance_mm: float
) -> Estimated | None:
    """Error of the distance of the targets, mm, mean of x and y: too long, it shortens slopes alone."""
    angles = [angle for angle in angle_scale_ppm if angle is not None]
    if len(angles) < len(scale_ppm):
        return None
    share = 1e-6 * distance_mm / len(angles)
    references = _if_all_stated([angle.reference for angle in angles])
    return Estimated(
        share * sum(length.value - angle.value for length, angle in zip(scale_ppm, angles, strict=True)),
        share * math.hypot(*(one.sigma for one in (*scale_ppm, *angles))),
        None if references is None else share * sum(references),
    )


@dataclass(frozen=True, slots=True, eq=False)
class WeightedFit:
    """Weighted least squares whose weights contain only the variances of a full covariance."""

    parameters: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    _degrees: float
    _ratio: float
    _stated: float

    @classmethod
    def of(cls, design: FloatArray, measured: FloatArray, covariance: FloatArray) -> WeightedFit:
        """Fit ``measured`` (n,) by ``design`` (n, k)."""
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
        """Standard deviation of the residuals against the stated one."""
        return Scatter(self._ratio * self._stated, self._stated, self._degrees)
