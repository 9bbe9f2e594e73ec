"""The result of a calibration: its evidence, its doubts, and the conditions under which it can be used."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from altd.mapping.grid import Axis
from altd.mapping.inverse import InverseMap
from altd.mapping.nodes import Fiducials
from altd.mapping.tensor_map import Fit, TensorMap
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.records import FloatArray


@dataclass(frozen=True, slots=True)
class Candidate:
    """One model that was tried on a target's nodes.

    ``model`` is its name as in the calibration file (``tensor``, ``lens`` …), ``degree`` that of a tensor
    polynomial along x and y, ``parameters`` the number of fitted parameters per target. ``gcv_px`` is the
    root of the generalised cross-validation score, ``leave_one_out_px`` the rms of the leave-one-out
    residuals. ``map_sigma_px`` is the rms error of the map over the hull by the nodes' noise: it grows with
    the degree while the misfit falls (thesis 3.5.6).
    """

    model: str
    degree: tuple[int, int] | None
    parameters: int
    gcv_px: float
    leave_one_out_px: float
    map_sigma_px: float


@dataclass(frozen=True, slots=True, eq=False)
class TargetEvidence:
    """A target's nodes and the models that were tried on them.

    ``nodes_mm`` (n, 2) and ``nodes_px`` (n, 2) are the nodes that were used, ``residuals_px`` (n, 2) measured
    minus mapped, ``leave_one_out_residuals_px`` (n, 2) measured minus mapped without the node,
    ``scatter_px`` (n, 2) the standard deviation of single exposures at the node (NaN where it has one),
    ``exposures`` (n,) their number. ``relative_sigma`` (n,) is 1 for an ordinary node, more for one whose
    spot is less certain and has a lower weight. ``excluded`` lists the unused nodes (x, y) mm with the
    reasons, ``unmeasured`` the used ones whose spot the calibrated unit would refuse. ``leds_dropped``
    describes the frame LEDs that shine but could not be located.
    """

    name: str
    nodes_mm: FloatArray
    nodes_px: FloatArray
    residuals_px: FloatArray
    leave_one_out_residuals_px: FloatArray
    relative_sigma: FloatArray
    scatter_px: FloatArray
    exposures: tuple[int, ...]
    excluded: tuple[tuple[tuple[float, float], str], ...]
    leds_dropped: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    unmeasured: tuple[tuple[tuple[float, float], str], ...] = ()


_MAX_NODES = 256
"""Maximum number of nodes along an axis; a plate of LEDs has up to 100."""
_MAX_DEGREE = 15
"""Maximum degree of a map; above it, powers lose digits (``gram_powers``)."""
_MAX_FACTOR_COLUMNS = 2 * (_MAX_DEGREE + 1) ** 2
"""Maximum number of columns of a covariance factor: two per coefficient, as ``fit_tensor_map`` makes."""
_MAX_CORNERS = 4 * _MAX_NODES
_MAX_OUTSIDE_SHARE = 0.25
"""Maximum distance of hull corners outside the picture, as a share of its size; corners were seen in it."""
_MIN_EDGE_MM = 1e-3
_MAX_BEND_SINE = 1e-4
"""Maximum sine of an inward bend at a corner, caused by rounding."""


def check_calibration(calibration: Calibration) -> None:
    """Raise ValueError with the target and the map if a calibration cannot be used for measurements.

    The checks go beyond field types; the file's checksum shows that it is unchanged, not that it is right.
    """
    names = calibration.target_names
    if len(set(names)) < len(names):
        raise ValueError("targets: two targets have the same name")
    if any(after.z_mm <= before.z_mm for before, after in itertools.pairwise(calibration.targets)):
        raise ValueError("targets: z_mm must grow from target to target, in beam order")
    for target in calibration.targets:
        place = f"targets.{target.name}"
        for name, fitted in (("map", target.map), ("cross_check.map", target.cross_check.map)):
            _check_grid(f"{place}.{name}", fitted)
            _check_hull(f"{place}.{name}.hull_mm", fitted.hull_mm, fitted.x_axis, fitted.y_axis)
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                _check_map(f"{place}.map", target)
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            raise ValueError(f"{place}.map: its numbers are too large to compute with") from error


def _check_grid(place: str, fitted: TensorMap) -> None:
    for name, axis, degree in zip("xy", (fitted.x_axis, fitted.y_axis), fitted.degree, strict=True):
        if axis.nodes > _MAX_NODES:
            raise ValueError(f"{place}.{name}_axis: has {axis.nodes} nodes, more than {_MAX_NODES}")
        most = min(axis.nodes - 1, _MAX_DEGREE)
        if not 1 <= degree <= most:
            raise ValueError(f"{place}.degree: {degree} along {name}, but it must be 1 to {most}")
    errors = fitted.covariance_factor_px.shape[2]
    if errors < 1:
        raise ValueError(f"{place}.spread: is empty, so the map's uncertainty is unknown")
    if errors > _MAX_FACTOR_COLUMNS:
        raise ValueError(f"{place}.spread: has {errors} columns, more than {_MAX_FACTOR_COLUMNS}")


def _check_hull(place: str, hull_mm: FloatArray, x_axis: Axis, y_axis: Axis) -> None:
    """Raise ValueError unless a hull is convex, counter-clockwise, simple and at most a step off the grid."""
    if len(hull_mm) > _MAX_CORNERS:
        raise ValueError(f"{place}: has {len(hull_mm)} corners, more than {_MAX_CORNERS}")
    first = np.array([axis.first_mm - axis.step_mm for axis in (x_axis, y_axis)])
    last = np.array([axis.last_mm + axis.step_mm for axis in (x_axis, y_axis)])
    if not ((first <= hull_mm) & (hull_mm <= last)).all():
        raise ValueError(f"{place}: reaches beyond the grid")
    edge = np.roll(hull_mm, -1, axis=0) - hull_mm
    length = np.hypot(edge[:, 0], edge[:, 1])
    if length.min() < _MIN_EDGE_MM:
        raise ValueError(f"{place}: two corners in a row are the same")
    ahead = edge / length[:, None]
    after = np.roll(ahead, -1, axis=0)
    sines = ahead[:, 0] * after[:, 1] - ahead[:, 1] * after[:, 0]
    turns = np.arctan2(sines, np.einsum("ij,ij->i", ahead, after)).sum() / (2 * np.pi)
    if sines.min() < -_MAX_BEND_SINE or round(turns) != 1:
        raise ValueError(f"{place}: is not a counter-clockwise convex polygon")


def _check_map(place: str, target: TargetCalibration) -> None:
    """Raise ValueError unless the hull is in the picture, the map one to one, and its inverse right."""
    fitted = target.map
    hull_px = fitted.to_px(fitted.hull_mm)
    size = np.array([target.width, target.height], dtype=np.float64)
    if not ((-_MAX_OUTSIDE_SHARE * size <= hull_px) & (hull_px <= (1 + _MAX_OUTSIDE_SHARE) * size)).all():
        raise ValueError(f"{place}: puts its hull outside of the picture")
    if fitted.folds:
        raise ValueError(f"{place}: puts two places of its hull on one pixel")
    middle_mm = fitted.hull_mm.mean(axis=0)
    u_px, v_px = fitted.to_px(middle_mm[None])[0].tolist()
    point = target.point(u_px, v_px)
    if point is None or not np.allclose((point.x_mm, point.y_mm), middle_mm, atol=1e-3):
        raise ValueError(f"{place}: does not find a place from its pixel")
    target.cross_check.difference_px(point.x_mm, point.y_mm, u_px, v_px)


Progress = Callable[[int, int], None]
"""Callback with the number of processed frames and their total."""


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """A calibration, its evidence, and messages to the user.

    ``refused`` lists nodes and lights that were not used, ``doubts`` possible errors of the calibration,
    ``remarks`` findings. ``evidence`` is in the order of the targets.
    """

    calibration: Calibration
    refused: tuple[str, ...]
    evidence: tuple[TargetEvidence, ...]
    doubts: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TargetsResult:
    """The part of a ``CalibrationResult`` from the scans, or from the plates, among the recordings."""

    targets: tuple[TargetCalibration, ...] = ()
    refused: tuple[str, ...] = ()
    evidence: tuple[TargetEvidence, ...] = ()
    doubts: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    fiducials: Mapping[str, Fiducials] = field(default_factory=dict)
    """Of the prints that guide a target's map, by the target's name."""


def residual_distances_mm(fit: Fit, nodes_mm: FloatArray) -> FloatArray:
    """Distance (n,) of each node (n, 2) from its known place by the map: Eq. 3.1 for the nodes themselves."""
    nodes_px = fit.map.to_px(nodes_mm) + fit.residuals_px
    _, jacobian, _ = InverseMap(fit.map).to_mm(nodes_px)
    offsets: FloatArray = np.linalg.norm(np.einsum("nij,nj->ni", jacobian, fit.residuals_px), axis=1)
    return offsets


def cross_check_doubts(targets: Sequence[TargetCalibration]) -> tuple[str, ...]:
    """Describe the targets whose two maps differ by more than the limit for measurements."""
    return tuple(
        f"{target.name}: the {target.map.model} and the {target.cross_check.map.model} map lie up to "
        f"{target.cross_check.max_difference_px:.2f} px apart; where it is more than "
        f"{target.cross_check.limit_px:.2f} px a measurement will be implausible"
        for target in targets
        if target.cross_check.max_difference_px > target.cross_check.limit_px
    )
