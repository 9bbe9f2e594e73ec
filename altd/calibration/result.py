"""The result of a calibration command, and the common part of making one from a scan and from a plate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from altd.calibration.soundness import TargetEvidence
from altd.mapping.inverse import InverseMap
from altd.mapping.tensor_map import Fit
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.records import FloatArray

Progress = Callable[[int, int], None]
"""Told how many of how many frames are done."""


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """A calibration, what it rests on, and in words what a person should know.

    ``refused`` are the nodes that it was made without, ``doubts`` what may be wrong with it, ``remarks`` what
    was found out on the way. ``evidence`` is in the order of the targets.
    """

    calibration: Calibration
    refused: tuple[str, ...]
    evidence: tuple[TargetEvidence, ...]
    doubts: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TargetsResult:
    """The part of a ``CalibrationResult`` that the scans, or the plates, among the recordings gave."""

    targets: tuple[TargetCalibration, ...] = ()
    refused: tuple[str, ...] = ()
    evidence: tuple[TargetEvidence, ...] = ()
    doubts: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def residual_distances_mm(fit: Fit, nodes_mm: FloatArray) -> FloatArray:
    """Eq. 3.1 for the nodes (n, 2) themselves: how far from its known place the map puts each one, (n,)."""
    nodes_px = fit.map.to_px(nodes_mm) + fit.residuals_px
    _, jacobian, _ = InverseMap.of(fit.map).to_mm(nodes_px)
    offsets: FloatArray = np.linalg.norm(np.einsum("nij,nj->ni", jacobian, fit.residuals_px), axis=1)
    return offsets


def cross_check_doubts(targets: Sequence[TargetCalibration]) -> tuple[str, ...]:
    """The places at which the two maps of a target lie farther apart than measurements may."""
    return tuple(
        f"{target.name}: the {target.map.model} and the {target.cross_check.map.model} map lie up to "
        f"{target.cross_check.max_difference_px:.2f} px apart; where it is more than "
        f"{target.cross_check.limit_px:.2f} px a measurement will be implausible"
        for target in targets
        if target.cross_check.max_difference_px > target.cross_check.limit_px
    )
