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
    common_area,
    name_of,
    points_of,
    unit_of,
    variances_of,
)
from altd.calibration.result import TargetEvidence
from altd.instruments.beam.instrument import MAX_PITCH_MM_PER_M, MAX_YAW_MM_PER_M
from altd.instruments.beam.refraction import SIGMAS, Refraction
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
    "glass_mm": "thickness of the window's glass",
    "glass_index": "refractive index of the glass",
}
_UNITS = {
    "stage_scale_ppm": "ppm",
    "stage_square_mrad": "mrad",
    "beam_normal_mm_per_m": "mm/m",
    "target_distance_mm": "mm",
    "temperature_k": "K",
    "glass_mm": "mm",
    "glass_index": "",
}


@dataclass(frozen=True, slots=True)
class Term:
    """One input of the measurement.

    ``value`` is its standard uncertainty in ``unit``, of ``distribution`` with ``degrees_of_freedom``
    (infinite: stated). ``contributions`` are its root mean square contributions, over the beams, to the
    budget's quantities, in their units.
    """

    key: str
    value: float
    unit: str
    distribution: str
    degrees_of_freedom: float
    contributions: tuple[float, ...]

    @property
    def name(self) -> str:
        """Name of the term as printed."""
        return _TERMS[self.key]

    @property
    def sensitivities(self) -> tuple[float, ...]:
        """Each contribution divided by the value, in the quantity's unit per the term's."""
        return tuple(contribution / self.value for contribution in self.contributions)


@dataclass(frozen=True, slots=True)
class Budget:
    """All terms for the beams that reach the area with slopes up to the stated range.

    ``not_stated`` are the keys of terms that count as 0 because they were not stated.
    """

    quantities: tuple[str, ...]
    terms: tuple[Term, ...]
    not_stated: tuple[str, ...]
    exposures: int

    @property
    def combined(self) -> tuple[float, ...]:
        """The combined standard uncertainty of each quantity (GUM, 5.1.2)."""
        columns = zip(*(term.contributions for term in self.terms), strict=True)
        return tuple(math.hypot(*column) for column in columns)

    @property
    def degrees_of_freedom(self) -> tuple[float, ...]:
        """Effective degrees of freedom, by Welch and Satterthwaite (GUM, G.2b)."""
        effective = []
        for combined, column in zip(
            self.combined, zip(*(term.contributions for term in self.terms), strict=True), strict=True
        ):
            shares = (
                (u / combined) ** 4 / term.degrees_of_freedom
                for u, term in zip(column, self.terms, strict=True)
            )
            total = sum(shares)
            effective.append(1 / total if total > 0 else math.inf)
        return tuple(effective)

    @property
    def coverage_factors(self) -> tuple[float, ...]:
        """Coverage factors for ``COVERAGE``, from Student's distribution (GUM, G.3)."""
        return tuple(student_quantile((1 + COVERAGE) / 2, freedom) for freedom in self.degrees_of_freedom)

    @property
    def expanded(self) -> tuple[float, ...]:
        """Expanded uncertainty of each quantity."""
        return tuple(k * u for k, u in zip(self.coverage_factors, self.combined, strict=True))

    def as_object(self) -> dict[str, Any]:
        """The budget as plain JSON types; infinite degrees of freedom are null."""

        def of_each(values: Sequence[float]) -> dict[str, float | None]:
            rounded = (float(f"{value:.4g}") if math.isfinite(value) else None for value in values)
            return dict(zip(self.quantities, rounded, strict=True))

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
                    "degrees_of_freedom": _whole(term.degrees_of_freedom),
                    "sensitivity": of_each(term.sensitivities),
                    "contribution": of_each(term.contributions),
                }
                for term in self.terms
            ],
            "not_stated": list(self.not_stated),
            "combined": of_each(self.combined),
            "degrees_of_freedom": of_each(self.degrees_of_freedom),
            "coverage_factor": of_each(self.coverage_factors),
            "expanded": of_each(self.expanded),
        }


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
    calibration: Calibration, evidence: Sequence[TargetEvidence], exposures: int = EXPOSURES
) -> Budget:
    """Compute the budget of a measurement of ``exposures`` exposures; raises ValueError like ``beams_of``."""
    beams = beams_of(calibration)
    variances = [variances_of(calibration, beam, exposures) for beam in beams]
    quantities = OF_SPOT if len(calibration.targets) == 1 else OF_BEAM
    freedom = _degrees_of_freedom(calibration, evidence)
    terms = []
    for key in variances[0]:
        mean: FloatArray = np.mean([of.get(key, np.zeros(len(quantities))) for of in variances], axis=0)
        contributions = tuple(float(u) for u in np.sqrt(mean))
        if key in freedom:
            value = math.sqrt(float(np.mean([u * u for u in contributions[:2]])))
            terms.append(Term(key, value, "mm", "normal, type A", freedom[key], contributions))
        else:
            stated = SIGMAS[key] if key in SIGMAS else getattr(calibration.limits, key)
            terms.append(Term(key, stated, _UNITS[key], "normal, stated", math.inf, contributions))
    known = (term for term in terms if max(term.contributions) > _MIN_CONTRIBUTION)
    not_stated = list(calibration.limits.not_stated)
    if len(calibration.targets) > 1 and Refraction.from_calibration(calibration) is None:
        not_stated.append("glass_mm")
    return Budget(quantities, tuple(known), tuple(not_stated), exposures)


def _degrees_of_freedom(calibration: Calibration, evidence: Sequence[TargetEvidence]) -> Mapping[str, float]:
    """Degrees of freedom of the terms that the scan shows: nodes and exposures, less fitted parameters."""
    nodes, exposures = 0.0, 0.0
    for target, seen in zip(calibration.targets, evidence, strict=True):
        of_model = (c.parameters for c in seen.candidates if c.model == target.map.model)
        nodes += max(2 * len(seen.nodes_mm) - max(of_model, default=0), 1)
        exposures += 2 * sum(count - 1 for count in seen.exposures)
    return {"pattern": nodes, "map": nodes, "scatter": max(exposures, 1.0)}


def budget_section(budget: Budget) -> list[Block]:
    """The budget as a table: one row per term, then combined and expanded uncertainty."""
    names = tuple(f"{name_of(key)}, {unit_of(key).strip()}" for key in budget.quantities)

    def numbers(values: Sequence[float]) -> tuple[str, ...]:
        return tuple(f"{value:.4f}" for value in values)

    rows = [
        (
            term.name,
            f"{term.value:.3g} {term.unit}",
            term.distribution,
            _shown_freedom(term.degrees_of_freedom),
            *numbers(term.contributions),
        )
        for term in budget.terms
    ]
    freedom = (_shown_freedom(number) for number in budget.degrees_of_freedom)
    factors = (f"{factor:.2f}" for factor in budget.coverage_factors)
    rows += [
        ("combined standard uncertainty", "", "", "", *numbers(budget.combined)),
        ("effective degrees of freedom", "", "", "", *freedom),
        (f"coverage factor for {100 * COVERAGE:.0f} %", "", "", "", *factors),
        ("expanded uncertainty", "", "", "", *numbers(budget.expanded)),
    ]
    words = (
        f"Contributions to one measurement of {budget.exposures} exposures, root mean square over beams that "
        "reach the calibrated area with slopes up to the stated range."
    )
    if "stage_mm" not in budget.not_stated:
        words += " The positioning of the stage is contained in the map, whose nodes scatter by it."
    if budget.not_stated:
        missing = ", ".join(_TERMS[key] for key in budget.not_stated)
        words += f" Not stated, so not contained: {missing}."
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
