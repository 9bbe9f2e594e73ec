"""Predictions of a calibration: sigma over the area, its parts, and the difference between two maps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.calibration.result import Candidate
from altd.instruments.beam.instrument import QUANTITIES
from altd.instruments.beam.refraction import Refraction
from altd.instruments.beam.systematics import effects_mm
from altd.mapping.grid import contains
from altd.mapping.tensor_map import TensorMap, tensor_basis
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.records import FloatArray, TargetPoint

OF_SPOT = ("x_mm", "y_mm")
OF_BEAM = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
"""The quantities measured with one target, and with two or more."""

_QUANTITIES = {quantity.key: quantity for quantity in QUANTITIES.of_unit}

CAUSES = ("pattern", "map", "scatter", "limits")
"""The parts of sigma: print and speckle of a place, the uncertainty of the map, the scatter of single
exposures, and the stated limits of effects that the scan does not show."""


def cause_of(key: str) -> str:
    """Cause of ``CAUSES`` to which a term of the budget belongs."""
    return key if key in CAUSES else "limits"


EXPOSURES = 20
"""Number of exposures for the predicted sigma: the default of ``measuring.window``."""

MAX_STACKED = 500
"""Maximum number of nodes in the picture of their covariance, whose points grow with its square."""

GRID = 21, 17
"""Number of places along x and y for a prediction; twice as many change the rms of sigma by less than 1 %."""


def name_of(key: str) -> str:
    """Name of a quantity as printed."""
    return _QUANTITIES[key].label


def unit_of(key: str) -> str:
    """Unit of a quantity as printed after a number."""
    unit = _QUANTITIES[key].unit
    return unit if unit == "°" else f" {unit}"


def two_digits(uncertainty: float) -> str:
    """An uncertainty as printed, with two significant digits (GUM, 7.2.6)."""
    rounded = float(f"{uncertainty:.1e}")
    is_number = math.isfinite(rounded) and rounded > 0
    return f"{rounded:.{max(1 - math.floor(math.log10(rounded)), 0)}f}" if is_number else f"{rounded:g}"


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Predicted sigma of a beam normal to the targets, over the area common to all targets.

    ``quantities`` is ``OF_BEAM``, or ``OF_SPOT`` for a single target. ``x_mm`` (columns,) and ``y_mm``
    (rows,) are the places, ``sigma`` (quantities, rows, columns) is in the quantities' units, NaN outside.
    ``shares`` (quantities, causes) are the shares of ``CAUSES`` in each variance, averaged over the area; a
    row adds up to 1. ``exposures`` is the number of averaged exposures.
    """

    quantities: tuple[str, ...]
    x_mm: FloatArray
    y_mm: FloatArray
    sigma: FloatArray
    shares: FloatArray
    exposures: int

    def rms(self, quantity: str) -> float:
        """Rms of sigma over the area."""
        return float(np.sqrt(np.nanmean(np.square(self.sigma[self.quantities.index(quantity)]))))

    def rms_after(self, quantity: str, exposures: FloatArray) -> FloatArray:
        """Rms of sigma for other numbers of exposures (n,): only the scatter falls with their number."""
        row = self.quantities.index(quantity)
        scatter = self.shares[row, CAUSES.index("scatter")]
        factor = np.sqrt(1 - scatter + scatter * self.exposures / exposures)
        rms: FloatArray = self.rms(quantity) * factor
        return rms


def predict(calibration: Calibration, exposures: int = EXPOSURES) -> Prediction:
    """Predict sigma from the maps and the repeatability, by the same formulas that a measurement uses.

    The scatter of single exposures counts as independent between the targets: a scan does not show how much
    of it moves all spots together and so does not affect yaw and pitch. Raises ValueError when the targets
    have no common area.
    """
    x_mm, y_mm = common_area(calibration.targets)
    quantities = OF_SPOT if len(calibration.targets) == 1 else OF_BEAM
    sigma = np.full((len(quantities), len(y_mm), len(x_mm)), np.nan)
    variances = np.zeros((len(quantities), len(CAUSES)))
    for row, y in enumerate(y_mm):
        line_mm = np.column_stack([x_mm, np.full(len(x_mm), y)])
        columns = np.flatnonzero(
            np.all([contains(t.map.hull_mm, line_mm) for t in calibration.targets], axis=0)
        )
        along = [points_of(target, line_mm[columns]) for target in calibration.targets]
        for column, *points in zip(columns, *along, strict=True):
            parts = variances_of(calibration, points, exposures)
            for cause, part in parts.items():
                variances[:, CAUSES.index(cause_of(cause))] += part.sum(axis=0)
            sigma[:, row, column] = np.sqrt(np.sum(list(parts.values()), axis=(0, 1)))
    shares = variances / variances.sum(axis=1, keepdims=True)
    return Prediction(quantities, x_mm, y_mm, sigma, shares, exposures)


def variances_of(
    calibration: Calibration, points: Sequence[TargetPoint], exposures: int
) -> dict[str, FloatArray]:
    """Compute the parts, by cause, of the variances of ``OF_BEAM``, or of a single ``OF_SPOT``.

    Each part (T, quantities) is split by target, ``limits`` also by their keys. All of them add up to the
    square of the published sigma.
    """
    z_mm = [target.z_mm for target in calibration.targets]
    parts = _covariances_mm2(calibration.targets, points, exposures)
    design = np.zeros((2 * len(z_mm), len(OF_BEAM)))
    design[0::2, 0] = design[1::2, 1] = 1.0
    design[0::2, 2], design[1::2, 3] = z_mm, z_mm
    if len(z_mm) == 1:
        design = design[:, : len(OF_SPOT)]
    weighted = np.linalg.solve(sum(parts.values()), design)
    gain = np.linalg.solve(design.T @ weighted, weighted.T)
    places_mm = np.array([(point.x_mm, point.y_mm) for point in points])
    slopes = (gain @ places_mm.ravel())[2:] if len(z_mm) > 1 else np.zeros(2)
    gain[2:] *= np.degrees(1 / (1 + np.square(slopes)))[: len(gain) - 2, None]
    effects = effects_mm(calibration.limits, z_mm, places_mm, (slopes[0], slopes[1]))
    if (refraction := Refraction.from_calibration(calibration)) is not None:
        effects |= refraction.effects_mm(slopes, z_mm)
    for key, columns in effects.items():
        parts[key] = columns @ columns.T
    by_target = (len(gain), len(z_mm), 2)
    return {
        cause: np.einsum("qi,ij,qj->qi", gain, part, gain).reshape(by_target).sum(axis=2).T
        for cause, part in parts.items()
    }


def own_noise_px(candidate: Candidate, nodes: int) -> float:
    """Scatter of the nodes about a candidate, from the definition of the cross-validation score."""
    free = 1 - candidate.parameters / (2 * nodes)
    return candidate.gcv_px * float(np.sqrt(max(free, 0.0)))


def noise_in_map_px(candidate: Candidate, nodes: int, noise_px: float) -> float:
    """Effect of a noise of ``noise_px`` at each node on a candidate's map, rms over the hull.

    A candidate's own ``map_sigma_px`` counts its misfit as noise and so falls with it. With the same noise
    for all candidates, it grows with the degree, as in Sec. 3.5.6.
    """
    own_px = own_noise_px(candidate, nodes)
    return candidate.map_sigma_px * noise_px / own_px if own_px > 0 else float("nan")


def common_area(targets: Sequence[TargetCalibration]) -> tuple[FloatArray, FloatArray]:
    """Places x (columns,) and y (rows,) over the rectangle common to the targets' hulls, mm.

    Raises ValueError when there is none.
    """
    low = np.max([target.map.hull_mm.min(axis=0) for target in targets], axis=0)
    high = np.min([target.map.hull_mm.max(axis=0) for target in targets], axis=0)
    if (low >= high).any():
        raise ValueError("the targets have no calibrated area in common")
    return np.linspace(low[0], high[0], GRID[0]), np.linspace(low[1], high[1], GRID[1])


def difference_mm(target: TargetCalibration, other: TensorMap, points_mm: FloatArray) -> FloatArray:
    """Displacement (n, 2) mm of spots by another map of the target: other minus the target's own.

    The target's own map puts the spots at points (n, 2) mm. The result is first-order, accurate to a few
    micrometres for maps that differ by less than a millimetre.
    """
    return offsets_mm(target, points_mm, target.map.to_px(points_mm) - other.to_px(points_mm))


def offsets_mm(target: TargetCalibration, nodes_mm: FloatArray, offsets_px: FloatArray) -> FloatArray:
    """Convert offsets (n, 2) px in the picture at nodes (n, 2) mm to (n, 2) mm on the target."""
    _, jacobian, _ = target.inverse.to_mm(target.map.to_px(nodes_mm))
    offsets: FloatArray = np.einsum("nij,nj->ni", jacobian, offsets_px)
    return offsets


def node_covariance_px2(fitted: TensorMap, nodes_mm: FloatArray) -> FloatArray:
    """Covariance (n, n) of the mapped u of nodes (n, 2) mm, stacked column-wise: Eq. 3.53, Fig. 3.19.

    Of more than ``MAX_STACKED`` nodes, it contains only every second, third …: no picture shows more.
    """
    stacked = nodes_mm[np.lexsort((nodes_mm[:, 1], np.rint(nodes_mm[:, 0])))]
    stacked = stacked[:: -(-len(stacked) // MAX_STACKED)]
    basis = tensor_basis((fitted.x_axis, fitted.y_axis), fitted.degree, stacked)
    spread = basis @ fitted.covariance_factor_px[0]
    covariance: FloatArray = spread @ spread.T
    return covariance


def spectrum_covariance_px2(fitted: TensorMap) -> FloatArray:
    """Covariance (K, K) of the spectrum of u, stacked row by row: Eq. 3.51."""
    covariance: FloatArray = fitted.covariance_factor_px[0] @ fitted.covariance_factor_px[0].T
    return covariance


def points_of(target: TargetCalibration, points_mm: FloatArray) -> list[TargetPoint]:
    """Measured points of spots at places (n, 2) mm of a target."""
    found, jacobian, covariance = target.inverse.to_mm(target.map.to_px(points_mm))
    return [
        TargetPoint(float(x), float(y), jacobian[n], covariance[n]) for n, (x, y) in enumerate(found.tolist())
    ]


def _covariances_mm2(
    targets: Sequence[TargetCalibration], points: Sequence[TargetPoint], exposures: int
) -> dict[str, FloatArray]:
    """Covariances (2 T, 2 T) of the points by cause; they add up to the joint covariance of a measurement."""
    size = 2 * len(points)
    parts = {cause: np.zeros((size, size)) for cause in CAUSES if cause != "limits"}
    for index, (target, point) in enumerate(zip(targets, points, strict=True)):
        block = slice(2 * index, 2 * index + 2)
        jacobian = point.jacobian_mm_per_px
        pattern_mm2 = jacobian @ target.map.noise_covariance_px2 @ jacobian.T
        parts["pattern"][block, block] = pattern_mm2
        parts["map"][block, block] = point.covariance_mm2 - pattern_mm2
        scatter_px2 = np.diag(target.repeatability_px**2 / exposures)
        parts["scatter"][block, block] = jacobian @ scatter_px2 @ jacobian.T
    return parts
