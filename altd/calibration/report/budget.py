"""The uncertainty budget of a calibration, after the GUM (JCGM 100:2008): terms, combined and expanded."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from altd.calibration.report.document import Block, Heading, Table, Words
from altd.calibration.report.prediction import (
    EXPOSURES,
    OF_BEAM,
    OF_SPOT,
    cause_of,
    common_area,
    name_of,
    points_of,
    two_digits,
    unit_of,
    variances_of,
)
from altd.calibration.result import TargetEvidence
from altd.instruments.beam.instrument import MAX_PITCH_MM_PER_M, MAX_YAW_MM_PER_M
from altd.instruments.beam.refraction import SIGMAS
from altd.mapping.grid import contains
from altd.measuring.calibration import Calibration
from altd.records import FloatArray, TargetPoint

COVERAGE = 0.95
_MIN_CONTRIBUTION = 1e-9
"""Minimum contribution, mm or degrees; smaller ones are rounding of a term without effect."""
_MAX_SHOWN_FREEDOM = 9999
_LINES = 5
"""Number of places, and of slopes, along an axis."""

_TERMS = {
    "pattern": "print and speckle under the spot",
    "map": "map from the nodes of the scan",
    "scatter": "scatter of single exposures",
    "stage_mm": "positioning of the stage",
    "stage_scale_ppm": "scale of the stage",
    "stage_square_mrad": "angle between the stage's axes",
    "beam_normal_mm_per_m": "calibrating beam against the normal",
    "target_distance_mm": "distance of the targets",
    "temperature_k": "temperature of the frame",
    "plate_mm": "place of the plate on the first target",
    "plate_turn_mrad": "turn of the plate on each target",
    "plate_keystone_per_m": "tilt of the plate over the camera's distance",
    "glass_mm": "thickness of the window's glass",
    "glass_index": "refractive index of the glass",
}
_UNITS = {
    "stage_scale_ppm": "ppm",
    "stage_square_mrad": "mrad",
    "beam_normal_mm_per_m": "mm/m",
    "temperature_k": "K",
    "plate_turn_mrad": "mrad",
    "plate_keystone_per_m": "1/m",
    "glass_index": "",
}


@dataclass(frozen=True, slots=True)
class Term:
    """One input of the measurement.

    ``value`` is its standard uncertainty in ``unit``, of ``distribution``. ``by_target`` are its root mean
    square contributions, over the beams, to the budget's quantities, in their units: a row for each target
    with an estimate of its own, with its ``degrees_of_freedom`` (infinite: stated).
    """

    key: str
    value: float
    unit: str
    distribution: str
    degrees_of_freedom: tuple[float, ...]
    by_target: tuple[tuple[float, ...], ...]

    @property
    def name(self) -> str:
        """Name of the term as printed."""
        return term_name(self.key)

    @property
    def contributions(self) -> tuple[float, ...]:
        """Contribution of all targets to each quantity."""
        return tuple(math.hypot(*column) for column in zip(*self.by_target, strict=True))

    @property
    def sensitivities(self) -> tuple[float, ...]:
        """Each contribution divided by the value, in the quantity's unit per the term's."""
        return tuple(contribution / self.value for contribution in self.contributions)


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """A combined standard uncertainty (GUM, 5.1.2) with its effective degrees of freedom."""

    standard: float
    degrees_of_freedom: float

    @property
    def coverage_factor(self) -> float:
        """Coverage factor for ``COVERAGE``, from Student's distribution (GUM, G.3)."""
        return student_quantile((1 + COVERAGE) / 2, self.degrees_of_freedom)

    @property
    def expanded(self) -> float:
        """Expanded uncertainty for ``COVERAGE``."""
        return self.coverage_factor * self.standard


def combine(parts: Sequence[tuple[str, Sequence[float], FloatArray]]) -> tuple[Uncertainty, ...]:
    """Combine the variances (T, quantities) of terms, each with its key and T degrees of freedom.

    The effective degrees of freedom are those of Welch and Satterthwaite (GUM, G.2b), which holds for
    estimates that are independent of each other. Pattern and map of a target are both proportional to one
    estimate, the scatter of its nodes, so they count as one.
    """
    estimates: dict[tuple[str, int], tuple[float, FloatArray]] = {}
    for key, freedom, variances in parts:
        for number, (free, variance) in enumerate(zip(freedom, variances, strict=True)):
            estimate = ("pattern" if key == "map" else key, number)
            estimates[estimate] = free, estimates.get(estimate, (free, 0.0))[1] + variance
    total = np.sum([variance for _, variance in estimates.values()], axis=0)
    squares = np.sum([np.square(variance) / free for free, variance in estimates.values()], axis=0)
    return tuple(
        Uncertainty(math.sqrt(of_all), of_all**2 / square if square > 0 else math.inf)
        for of_all, square in zip(total.tolist(), squares.tolist(), strict=True)
    )


@dataclass(frozen=True, slots=True)
class Budget:
    """All terms for the beams that reach the area with slopes up to the stated range.

    ``not_stated`` are the keys of terms that count as 0 because they were not stated. ``worst`` is the
    uncertainty of each quantity for the beam with the largest expanded one; ``rms`` is over all beams.
    """

    quantities: tuple[str, ...]
    terms: tuple[Term, ...]
    not_stated: tuple[str, ...]
    exposures: int
    worst: tuple[Uncertainty, ...]

    @property
    def rms(self) -> tuple[Uncertainty, ...]:
        """The uncertainty of each quantity, root mean square over the beams."""
        return combine([(t.key, t.degrees_of_freedom, np.square(t.by_target)) for t in self.terms])

    @property
    def combined(self) -> tuple[float, ...]:
        """The combined standard uncertainty of each quantity."""
        return tuple(of.standard for of in self.rms)

    @property
    def expanded(self) -> tuple[float, ...]:
        """Expanded uncertainty of each quantity."""
        return tuple(of.expanded for of in self.rms)

    @property
    def missing(self) -> str:
        """Names of the terms that were not stated."""
        return ", ".join(_TERMS[key] for key in self.not_stated)

    def as_object(self) -> dict[str, Any]:
        """The budget as plain JSON types; infinite degrees of freedom are null."""

        def of_each(values: Sequence[float]) -> dict[str, float | None]:
            rounded = (float(f"{value:.4g}") if math.isfinite(value) else None for value in values)
            return dict(zip(self.quantities, rounded, strict=True))

        def of_beams(uncertainties: Sequence[Uncertainty]) -> dict[str, dict[str, float | None]]:
            return {
                "combined": of_each([of.standard for of in uncertainties]),
                "degrees_of_freedom": of_each([of.degrees_of_freedom for of in uncertainties]),
                "coverage_factor": of_each([of.coverage_factor for of in uncertainties]),
                "expanded": of_each([of.expanded for of in uncertainties]),
            }

        return {
            "exposures": self.exposures,
            "coverage": COVERAGE,
            "terms": [
                {
                    "key": term.key,
                    "name": term.name,
                    "value": float(f"{term.value:.4g}"),
                    "unit": term.unit,
                    "distribution": term.distribution,
                    "degrees_of_freedom": _whole(sum(term.degrees_of_freedom)),
                    "degrees_of_freedom_by_target": [_whole(free) for free in term.degrees_of_freedom],
                    "sensitivity": of_each(term.sensitivities),
                    "contribution": of_each(term.contributions),
                }
                for term in self.terms
            ],
            "not_stated": list(self.not_stated),
            **of_beams(self.rms),
            "worst": of_beams(self.worst),
        }


def term_name(key: str) -> str:
    """Name of a term as printed."""
    return _TERMS[key]


def unit_of_term(key: str) -> str:
    """Unit of a term's value."""
    return _UNITS.get(key, "mm")


def student_quantile(probability: float, degrees_of_freedom: float) -> float:
    """Quantile of Student's distribution by its expansion (Abramowitz and Stegun, 26.7.5).

    It is accurate to 0.1 % for 97.5 % and six degrees of freedom or more.
    """
    x = NormalDist().inv_cdf(probability)
    if not math.isfinite(degrees_of_freedom):
        return x
    terms = (
        (x**3 + x) / 4,
        (5 * x**5 + 16 * x**3 + 3 * x) / 96,
        (3 * x**7 + 19 * x**5 + 17 * x**3 - 15 * x) / 384,
    )
    return x + sum(term / degrees_of_freedom ** (n + 1) for n, term in enumerate(terms))


def beams_of(calibration: Calibration) -> list[list[TargetPoint]]:
    """Points of beams spread evenly over the first target and the stated range that meet all targets.

    For a single target, its places are used. Raises ValueError when the targets have no common area.
    """
    x_mm, y_mm = (np.linspace(axis[0], axis[-1], _LINES) for axis in common_area(calibration.targets))
    places_mm = np.stack(np.meshgrid(x_mm, y_mm), axis=-1).reshape(-1, 2)
    targets = calibration.targets
    if len(targets) == 1:
        return [[point] for point in points_of(targets[0], places_mm) if math.isfinite(point.x_mm)]
    sx, sy = (np.linspace(-most, most, _LINES) * 1e-3 for most in (MAX_YAW_MM_PER_M, MAX_PITCH_MM_PER_M))
    slopes = np.stack(np.meshgrid(sx, sy), axis=-1).reshape(-1, 2)
    near, slope = (np.array(of) for of in zip(*itertools.product(places_mm, slopes), strict=True))
    along_mm = [near + slope * (target.z_mm - targets[0].z_mm) for target in targets]
    is_met = np.all([contains(t.map.hull_mm, mm) for t, mm in zip(targets, along_mm, strict=True)], axis=0)
    points = (points_of(target, mm[is_met]) for target, mm in zip(targets, along_mm, strict=True))
    return [list(beam) for beam in zip(*points, strict=True)]


def budget_of(
    calibration: Calibration, evidence: Sequence[TargetEvidence] = (), exposures: int = EXPOSURES
) -> Budget:
    """Compute the budget of a measurement of ``exposures`` exposures; raises ValueError like ``beams_of``.

    Without ``evidence`` the degrees of freedom are not known, and count as infinite.
    """
    single = len(calibration.targets) == 1
    quantities = OF_SPOT if single else OF_BEAM
    of_beams = [variances_of(calibration, beam, exposures) for beam in beams_of(calibration)]
    by_beam: dict[str, FloatArray] = {}  # (beams, targets, quantities)
    for key in dict.fromkeys(itertools.chain.from_iterable(of_beams)):
        none = np.zeros((len(calibration.targets), len(quantities)))
        by_beam[key] = np.array([of.get(key, none) for of in of_beams])
        if cause_of(key) == "limits":
            by_beam[key] = np.maximum(by_beam[key].sum(axis=1, keepdims=True), 0.0)  # rounding
    freedom = _degrees_of_freedom(calibration, evidence)
    terms = []
    for key, variances in by_beam.items():
        by_target = np.sqrt(variances.mean(axis=0))
        rows = tuple(tuple(row) for row in by_target.tolist())
        if key in freedom:
            value = math.sqrt(float(np.square(by_target[:, :2]).sum()) / 2)
            terms.append(Term(key, value, "mm", "normal, type A", freedom[key], rows))
        else:
            stated = SIGMAS[key] if key in SIGMAS else getattr(calibration.limits, key)
            terms.append(Term(key, stated, unit_of_term(key), "normal, stated", (math.inf,), rows))
    known = tuple(term for term in terms if max(term.contributions) > _MIN_CONTRIBUTION)
    of_each_beam = [
        combine([(term.key, term.degrees_of_freedom, by_beam[term.key][beam]) for term in known])
        for beam in range(len(of_beams))
    ]
    worst = tuple(max(column, key=lambda of: of.expanded) for column in zip(*of_each_beam, strict=True))
    not_stated = list(calibration.limits.not_stated)
    if not single and all(target.glass is None for target in calibration.targets):
        not_stated.append("glass_mm")
    return Budget(quantities, known, tuple(not_stated), exposures, worst)


def _degrees_of_freedom(
    calibration: Calibration, evidence: Sequence[TargetEvidence]
) -> Mapping[str, tuple[float, ...]]:
    """Degrees of freedom, by target, of the terms that the scan shows.

    They are those of nodes and exposures, less fitted parameters.
    """
    if not evidence:
        return dict.fromkeys(("pattern", "map", "scatter"), (math.inf,) * len(calibration.targets))
    nodes, exposures = [], []
    for target, seen in zip(calibration.targets, evidence, strict=True):
        of_model = (
            tried.parameters
            for tried in seen.candidates
            if tried.model == target.map.model and tried.degree in (None, target.map.degree)
        )
        nodes.append(float(max(2 * len(seen.nodes_mm) - max(of_model, default=0), 1)))
        exposures.append(float(max(2 * sum(count - 1 for count in seen.exposures), 1)))
    return {"pattern": tuple(nodes), "map": tuple(nodes), "scatter": tuple(exposures)}


def budget_section(budget: Budget) -> list[Block]:
    """The budget as a table: one row per term, then combined and expanded uncertainty."""
    names = tuple(f"{name_of(key)}, {unit_of(key).strip()}" for key in budget.quantities)
    rows = [
        (
            term.name,
            f"{term.value:.3g} {term.unit}",
            term.distribution,
            ", ".join(map(_shown_freedom, term.degrees_of_freedom)),
            *(f"{value:.4f}" for value in term.contributions),
        )
        for term in budget.terms
    ]
    for beams, of_each in (("rms", budget.rms), ("at worst", budget.worst)):
        for name, numbers in (
            (f"combined standard uncertainty, {beams}", (two_digits(of.standard) for of in of_each)),
            ("effective degrees of freedom", (_shown_freedom(of.degrees_of_freedom) for of in of_each)),
            (f"coverage factor for {100 * COVERAGE:.0f} %", (f"{of.coverage_factor:.2f}" for of in of_each)),
            (f"expanded uncertainty, {beams}", (two_digits(of.expanded) for of in of_each)),
        ):
            rows.append((name, "", "", "", *numbers))
    words = (
        f"Contributions to one measurement of {budget.exposures} exposures, root mean square over beams that "
        "reach the calibrated area with slopes up to the stated range; “at worst” is the beam with the "
        "largest one. Degrees of freedom are those of each target. Pattern and map of a target come from the "
        "scatter of the same nodes, so they count as one estimate in the effective degrees of freedom."
    )
    if "stage_mm" not in budget.not_stated:
        words += " The positioning of the stage is contained in the map, whose nodes scatter by it."
    if budget.not_stated:
        words += f" Not stated, so not contained: {budget.missing}."
    share = 0.34 / len(names)
    columns = ("source", "standard uncertainty", "distribution", "degrees of freedom", *names)
    return [
        Heading("Uncertainty budget"),
        Table(columns, tuple(rows), (0.27, 0.14, 0.13, 0.12, *[share] * len(names))),
        Words(words),
    ]


def _shown_freedom(number: float) -> str:
    return f"{number:.0f}" if number <= _MAX_SHOWN_FREEDOM else "∞"


def _whole(number: float) -> int | None:
    return round(number) if math.isfinite(number) else None
