"""Judge a calibration in plain words: criteria, limiting causes and remedies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from altd.calibration.report.prediction import CAUSES, Prediction, name_of, unit_of
from altd.calibration.result import TargetEvidence
from altd.measuring.calibration import Calibration, TargetCalibration

_GOOD_DEG, _USABLE_DEG = 0.0030, 0.0200
_GOOD_MM, _USABLE_MM = 0.0120, 0.0500
"""Limits of predicted sigma: a unit with strong speckle reaches good, the thesis usable (Tables 3.1, 3.4)."""

_GOOD_NODES_MM, _USABLE_NODES_MM = 0.020, 0.0714
"""Limits of the nodes' mean distance from the map; usable is Table 3.3, semi-transparent target."""

_GOOD_SCATTER_PX, _USABLE_SCATTER_PX = 0.0747, 0.20
"""Limits of the scatter of single exposures at one node; good is Table 3.3."""

_GOOD_OUTLIER, _USABLE_OUTLIER = 4.5, 6.0
"""Limits of the worst node's leave-one-out residual over the rms of all: of 60 nodes with normal errors,
one exceeds 4.5 once in four hundred calibrations."""

_MAX_EXCLUDED_SHARE = 0.1
_MIN_LEDS = 3
"""Minimum number of LEDs; fewer do not separate a shift of the picture from rotation and scale."""


class Level(IntEnum):
    """The grade of a check; a calibration is as good as its worst check."""

    GOOD = 0
    USABLE = 1
    BAD = 2

    @property
    def word(self) -> str:
        """Name of the level as printed."""
        return ("good", "usable", "not good")[self]


@dataclass(frozen=True, slots=True)
class Check:
    """One judged number: its value and the wanted one, in words, and the remedy if it is not good."""

    name: str
    value: str
    wanted: str
    level: Level
    remedy: str = ""


@dataclass(frozen=True, slots=True)
class ReportVerdict:
    """The calibration's level, the checks behind it and what limits the measurement."""

    checks: tuple[Check, ...]
    limit: str
    advice: str

    @property
    def level(self) -> Level:
        """The level of the worst check."""
        return max(check.level for check in self.checks)

    @property
    def headline(self) -> str:
        """The verdict in one sentence or two."""
        return {
            Level.GOOD: "This calibration is good.",
            Level.USABLE: "This calibration is usable, but below the required quality.",
            Level.BAD: "This calibration is not good. Do not measure with it.",
        }[self.level]

    @property
    def remedies(self) -> tuple[str, ...]:
        """The remedies for the checks that are not good, each once."""
        return tuple(dict.fromkeys(check.remedy for check in self.checks if check.level > Level.GOOD))


def judge(
    calibration: Calibration, evidence: Sequence[TargetEvidence], prediction: Prediction
) -> ReportVerdict:
    """Judge a calibration by its maps, its evidence and its predicted sigma."""
    limit, advice = _limit(prediction, calibration.targets)
    checks = [
        *_predictions(prediction, calibration.targets),
        *_of_maps(calibration.targets),
        _of_cross_checks(calibration.targets),
        *_of_nodes(evidence),
        _of_leds(calibration.targets),
    ]
    return ReportVerdict(tuple(checks), limit, advice)


def _predictions(prediction: Prediction, targets: Sequence[TargetCalibration]) -> list[Check]:
    advice = _advice(prediction, targets)
    remedy = f"{advice[0].upper()}{advice[1:]}."
    checks = []
    for quantity, good, usable in (
        ("yaw_deg", _GOOD_DEG, _USABLE_DEG),
        ("pitch_deg", _GOOD_DEG, _USABLE_DEG),
        ("x_mm", _GOOD_MM, _USABLE_MM),
        ("y_mm", _GOOD_MM, _USABLE_MM),
    ):
        if quantity not in prediction.quantities:
            continue
        name, unit = name_of(quantity), unit_of(quantity)
        rms, worst = prediction.rms(quantity), prediction.worst(quantity)
        checks.append(
            Check(
                f"Predicted sigma of {name}",
                f"{rms:.4f}{unit} rms, {worst:.4f}{unit} at worst",
                f"rms at most {good:.4f}{unit}",
                _level(rms, good, usable),
                remedy,
            )
        )
    return checks


def _of_maps(targets: Sequence[TargetCalibration]) -> list[Check]:
    mean_mm = [target.residual_mean_mm for target in targets]
    scatter_px = [float(target.repeatability_px.max()) for target in targets]
    return [
        Check(
            "Mean residual of the nodes",
            _each(targets, [f"{value:.4f}" for value in mean_mm], " mm"),
            f"at most {_GOOD_NODES_MM:.4f} mm",
            _level(max(mean_mm), _GOOD_NODES_MM, _USABLE_NODES_MM),
            "Inspect the residual vectors: parallel ones are an error of the stage or the lens model, random "
            "ones a bad view of the spots: clean the window, check the laser.",
        ),
        Check(
            "Scatter of single exposures",
            _each(targets, [f"{value:.3f}" for value in scatter_px], " px"),
            f"at most {_GOOD_SCATTER_PX:.3f} px",
            _level(max(scatter_px), _GOOD_SCATTER_PX, _USABLE_SCATTER_PX),
            "Let stage and laser settle, avoid vibration and draught, take more exposures per node.",
        ),
    ]


def _of_cross_checks(targets: Sequence[TargetCalibration]) -> Check:
    checks = [target.cross_check for target in targets]
    apart = any(check.max_difference_px > check.limit_px for check in checks)
    return Check(
        "Cross-check, maximum difference of the maps",
        _each(targets, [f"{check.max_difference_px:.2f}" for check in checks], " px"),
        _each(targets, [f"{check.limit_px:.2f}" for check in checks], " px"),
        Level.USABLE if apart else Level.GOOD,
        "Two independent maps differ by more than noise explains, and measurements there will be marked "
        "implausible: look for nodes with large residuals and for a stage with unequal steps, and repeat the "
        "scan with more nodes.",
    )


def _of_nodes(evidence: Sequence[TargetEvidence]) -> list[Check]:
    shares = [len(seen.excluded) / (len(seen.excluded) + len(seen.nodes_mm)) for seen in evidence]
    residuals = [
        np.linalg.norm(seen.leave_one_out_residuals_px, axis=1) / seen.relative_sigma for seen in evidence
    ]
    outliers = [float(off.max() / np.sqrt(np.mean(np.square(off)) / 2)) for off in residuals]
    counts = [f"{len(seen.excluded)} of {len(seen.excluded) + len(seen.nodes_mm)}" for seen in evidence]
    share = max(shares)
    measured = [len(seen.nodes_mm) - len(seen.unmeasured) for seen in evidence]
    return [
        Check(
            "Nodes whose spot the unit measures",
            _each(
                evidence,
                [f"{count} of {len(seen.nodes_mm)}" for count, seen in zip(measured, evidence, strict=True)],
                "",
            ),
            "all",
            Level.USABLE if any(seen.unmeasured for seen in evidence) else Level.GOOD,
            "The calibrated unit refuses the spot of a node: look for dirt and reflections at the places "
            "that `altd calibrate` names, and repeat the scan.",
        ),
        Check(
            "Nodes left out",
            _each(evidence, counts, ""),
            "none",
            Level.GOOD if share == 0 else Level.USABLE if share <= _MAX_EXCLUDED_SHARE else Level.BAD,
            "See the reasons under “Nodes left out”. A missing node at the edge reduces the "
            "measurable area: repeat the scan.",
        ),
        Check(
            "Worst node, over the rms of all",
            _each(evidence, [f"{outlier:.1f}" for outlier in outliers], " times"),
            f"at most {_GOOD_OUTLIER:g} times",
            _level(max(outliers), _GOOD_OUTLIER, _USABLE_OUTLIER),
            "One node is an outlier: look for a bumped stage, dirt or a reflection, and repeat the scan.",
        ),
    ]


def _of_leds(targets: Sequence[TargetCalibration]) -> Check:
    found = [len(target.leds_px) for target in targets]
    return Check(
        "Frame LEDs found",
        _each(targets, [str(count) for count in found], ""),
        f"at least {_MIN_LEDS}",
        Level.GOOD if min(found) >= _MIN_LEDS else Level.USABLE,
        "Record LED reference pairs before the grid, LEDs off and then on: without them a moved camera "
        "cannot be detected later.",
    )


def _each(
    named: Sequence[TargetCalibration] | Sequence[TargetEvidence], values: Sequence[str], unit: str
) -> str:
    names = [one.name for one in named]
    return ", ".join(f"{name} {value}" for name, value in zip(names, values, strict=True)) + unit


_CAUSE_WORDS = {
    "pattern": "the fixed pattern of print and speckle",
    "map": "the map",
    "scatter": "the scatter of single exposures",
    "limits": "the stated limits of stage and beam",
}
_ADVICE = {
    "pattern": "a larger laser spot covers more dots and speckle grains and shifts less; clean the targets; "
    "averaging longer does not help",
    "map": "scan with more nodes",
    "scatter": "average more exposures in a measurement; avoid vibration and draught",
    "limits": "scan a second time with the unit turned by 180°, and use a stage with smaller limits",
}


def _main_causes(prediction: Prediction) -> list[str]:
    """Causes with at least a third of the variance, the largest first; the largest if there are none."""
    shares = prediction.shares.mean(axis=0)
    order = np.argsort(shares)[::-1]
    return [CAUSES[n] for n in order if shares[n] >= 1 / 3] or [CAUSES[order[0]]]


def _advice(prediction: Prediction, targets: Sequence[TargetCalibration]) -> str:
    """Remedies for the main causes; if pattern is one, first a flat for targets without a recorded one."""
    causes = _main_causes(prediction)
    words = [_ADVICE[cause] for cause in causes]
    without = [target.name for target in targets if target.flat is None or target.flat.source == "print"]
    if "pattern" in causes and without:
        words.insert(0, f"record a flat of {' and '.join(without)} and calibrate a scan with it (--flat)")
    return "; ".join(words)


def _limit(prediction: Prediction, targets: Sequence[TargetCalibration]) -> tuple[str, str]:
    """Sentences on the shares of the variance, and on ways to reduce the uncertainty."""
    shares = prediction.shares.mean(axis=0)
    order = np.argsort(shares)[::-1]
    named = ", ".join(f"{_CAUSE_WORDS[CAUSES[n]]} {100 * shares[n]:.0f} %" for n in order)
    return f"Shares of the variance: {named}.", f"To reduce the uncertainty: {_advice(prediction, targets)}."


def _level(value: float, good: float, usable: float) -> Level:
    """Level of a value; NaN is bad."""
    return Level.GOOD if value <= good else Level.USABLE if value <= usable else Level.BAD
