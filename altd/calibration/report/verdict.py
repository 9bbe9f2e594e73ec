"""Judge a calibration in plain words: criteria, limiting causes and remedies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from altd.calibration.report.budget import Budget, Uncertainty, budget_of, term_name, unit_of_term
from altd.calibration.report.document import Level
from altd.calibration.report.prediction import CAUSES, OF_SPOT, cause_of, name_of, two_digits, unit_of
from altd.calibration.result import TargetEvidence
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.records.limits import LIMIT_KEYS, NO_LIMITS, Limits

REQUIRED = {"mm": 1.0, "deg": math.degrees(1e-3)}
"""Largest permissible error by the unit of a quantity: ±1 mm, and ±1 mm/m in yaw and pitch (thesis, A.1)."""

RULE = (
    "Decision rule: a quantity meets the requirement if its expanded uncertainty (95 %) at the worst place "
    "of the range is at most the permissible error, ±1 mm and ±1 mm/m. This is guarded acceptance with a "
    "guard band of the expanded uncertainty (JCGM 106:2012, 8.3.2), for a remaining error of 0. Otherwise it "
    "is not decided; it is not good if what the scan itself shows is already larger."
)
"""The decision rule."""

_USUAL = Limits(0.005, 50.0, 0.05, 0.3, 0.05, 10.0)
"""Limits of an ordinary stage and mounting, to tell what an uncertainty would be."""

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
    """The calibration's level, the checks behind it and what limits the measurement.

    ``uncertainty`` are sentences on it; ``undecided`` is the reason for a level that is not decided.
    """

    checks: tuple[Check, ...]
    uncertainty: tuple[str, ...]
    limit: str
    advice: str
    undecided: str

    @property
    def level(self) -> Level:
        """The level of the worst check."""
        return max(check.level for check in self.checks)

    @property
    def headline(self) -> str:
        """The verdict in one sentence or two."""
        return {
            Level.GOOD: "This calibration is good.",
            Level.USABLE: "This calibration is usable, but not all criteria are met.",
            Level.UNDECIDED: f"Not decided: {self.undecided}.",
            Level.BAD: "This calibration is not good. Do not measure with it.",
        }[self.level]

    @property
    def remedies(self) -> tuple[str, ...]:
        """The remedies for the checks that are not good, each once."""
        return tuple(dict.fromkeys(check.remedy for check in self.checks if check.level > Level.GOOD))


def judge(calibration: Calibration, evidence: Sequence[TargetEvidence], budget: Budget) -> ReportVerdict:
    """Judge a calibration by its maps, its evidence and its budget of uncertainty."""
    of_scan = budget_of(replace(calibration, limits=NO_LIMITS), evidence, budget.exposures)
    stated = {key: getattr(calibration.limits, key) for key in LIMIT_KEYS}
    filled = {key: getattr(_USUAL, key) if sigma is None else sigma for key, sigma in stated.items()}
    usual = budget_of(replace(calibration, limits=Limits(**filled)), evidence, budget.exposures)
    advice = _advice(budget, calibration.targets)
    checks = [
        *_requirements(budget, of_scan, advice),
        *_of_maps(calibration.targets),
        _of_cross_checks(calibration.targets),
        *_of_nodes(evidence),
        _of_leds(calibration.targets),
    ]
    return ReportVerdict(
        tuple(checks),
        _uncertainty(budget, usual, of_scan),
        _limit(budget),
        f"To reduce the uncertainty: {advice}.",
        _undecided(budget),
    )


def _undecided(budget: Budget) -> str:
    """Reason why a verdict is not decided, if the checks of the uncertainty are the reason."""
    if not budget.not_stated:
        return "the expanded uncertainty is larger than the permissible error"
    verb = "is" if len(budget.not_stated) == 1 else "are"
    return f"{budget.missing} {verb} not stated"


def _uncertainty(budget: Budget, usual: Budget, of_scan: Budget) -> tuple[str, ...]:
    """Sentences on the combined uncertainty, on its size with usual limits, and on the scan's own part."""
    lines = [
        f"Combined standard uncertainty of a measurement of {budget.exposures} exposures: "
        f"{_of_each(budget, budget.rms)} (rms over the range).",
        "Expanded uncertainty (95 %) at the worst place of the range: "
        f"{_of_each(budget, budget.worst, True)}.",
    ]
    if missing := [key for key in budget.not_stated if key in LIMIT_KEYS]:
        named = ", ".join(f"{term_name(key)} {getattr(_USUAL, key):g} {unit_of_term(key)}" for key in missing)
        would_be = _of_each(usual, usual.worst, True)
        lines.append(f"If what is not stated were as usual ({named}), it would be {would_be}.")
    own = _of_each(of_scan, of_scan.rms)
    lines.append(f"Rms error as the scan shows it, against a perfectly normal calibrating beam: {own}.")
    return tuple(lines)


def _of_each(budget: Budget, uncertainties: Sequence[Uncertainty], is_expanded: bool = False) -> str:
    """Phrase for the uncertainty of each quantity, yaw and pitch first."""
    stated = sorted(zip(budget.quantities, uncertainties, strict=True), key=lambda one: one[0] in OF_SPOT)
    *others, last = (
        (f"±{two_digits(of.expanded)}" if is_expanded else two_digits(of.standard))
        + f"{unit_of(key)} in {name_of(key)}"
        for key, of in stated
    )
    return f"{', '.join(others)} and {last}"


def _requirements(budget: Budget, of_scan: Budget, advice: str) -> list[Check]:
    """Compare each quantity, yaw and pitch first, with the permissible error, by ``RULE``."""
    remedy = f"{advice[0].upper()}{advice[1:]}."
    if budget.not_stated:
        remedy = f"State {budget.missing} (docs/budget.md), and calibrate again."
    open_end = " and what is not stated" if budget.not_stated else ""
    stated = zip(budget.quantities, budget.worst, of_scan.worst, strict=True)
    checks = []
    for quantity, worst, own in sorted(stated, key=lambda one: one[0] in OF_SPOT):
        unit, required = unit_of(quantity), REQUIRED[quantity.rpartition("_")[2]]
        is_met = worst.expanded <= required and not budget.not_stated
        checks.append(
            Check(
                f"Expanded uncertainty of {name_of(quantity)} (95 %), at worst",
                f"±{two_digits(worst.expanded)}{unit}{open_end}",
                f"at most ±{two_digits(required)}{unit}",
                Level.GOOD if is_met else Level.UNDECIDED if own.expanded <= required else Level.BAD,
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


def _shares(budget: Budget) -> dict[str, float]:
    """Share of each cause in the variance, mean of the quantities, the largest first."""
    shares = dict.fromkeys(CAUSES, 0.0)
    for term in budget.terms:
        of_each = np.square(np.divide(term.contributions, budget.combined))
        shares[cause_of(term.key)] += float(of_each.mean())
    return dict(sorted(shares.items(), key=lambda one: -one[1]))


def _advice(budget: Budget, targets: Sequence[TargetCalibration]) -> str:
    """Remedies for causes with a third of the variance, or the largest one.

    If the pattern is one, first a flat for targets without a recorded one.
    """
    shares = _shares(budget)
    causes = [cause for cause, share in shares.items() if share >= 1 / 3] or list(shares)[:1]
    words = [_ADVICE[cause] for cause in causes]
    made = "recording", "laser"
    without = [of.name for of in targets if of.flat is None or of.flat.source not in made]
    if "pattern" in causes and without:
        words.insert(0, f"record a flat of {' and '.join(without)} and calibrate a scan with it (--flat)")
    return "; ".join(words)


def _limit(budget: Budget) -> str:
    """Sentence on the shares of the variance."""
    named = ", ".join(
        f"{_CAUSE_WORDS[cause]} {100 * share:.0f} %" for cause, share in _shares(budget).items()
    )
    return f"Shares of the variance: {named}."


def _level(value: float, good: float, usable: float) -> Level:
    """Level of a value; NaN is bad."""
    return Level.GOOD if value <= good else Level.USABLE if value <= usable else Level.BAD
