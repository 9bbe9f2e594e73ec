"""Quantities of a row, and their values in a round."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from altd.instruments.row.instrument import RoundResult, TargetResult
from altd.measuring.instrument import Solution
from altd.records import FloatArray, Quantities, Quantity, Value

MEASURED = Quantity("measured", "measured", "", "number of targets that were measured", 1, has_sigma=False)
_OF_TARGET = (
    Quantity("x_mm", "x", "mm", "spot on the target", 4, is_optional=True),
    Quantity("y_mm", "y", "mm", "spot on the target", 4, is_optional=True),
    Quantity("dx_mm_per_day", "vx", "mm/d", "speed of the place in the last day", 4, is_optional=True),
    Quantity("dy_mm_per_day", "vy", "mm/d", "speed of the place in the last day", 4, is_optional=True),
    Quantity(
        "significance",
        "significance",
        "",
        "displacement in standard deviations, by chance above 3.0 in 1 % of the rounds",
        4,
        has_sigma=False,
        is_optional=True,
    ),
)
_AXES = {"x": "to the right as seen along the beam", "y": "up"}


def quantities_of(targets: Sequence[str]) -> Quantities:
    """Quantities of a row: the number of measured targets, and the displacement of each place."""
    places = tuple(
        Quantity(
            f"{name}_d{axis}_mm",
            f"{name} d{axis}",
            "mm",
            f"displacement of the place of {name} since the baseline, {way}",
            4,
            is_optional=True,
            place=name,
        )
        for name in targets
        for axis, way in _AXES.items()
    )
    return Quantities("chain", (MEASURED, *places), _OF_TARGET)


def solution_of(result: RoundResult) -> Solution:
    """Return the values of a round, empty if no target was measured."""
    measured = {name: of for name, of in result.targets.items() if of.place is not None}
    values = {MEASURED.key: Value(float(len(measured)))} if measured else {}
    for name, of in measured.items():
        if of.displacement is not None:
            moved = of.displacement
            axes = _axes(moved.mm, moved.covariance_mm2, moved.random_mm2)
            values |= {f"{name}_d{axis}_mm": value for axis, value in axes}
    return Solution(values, {name: _of_target(of) for name, of in result.targets.items()})


def _of_target(of: TargetResult) -> Mapping[str, Value] | None:
    if of.place is None:
        return None
    axes = _axes(of.place.mm, of.place.covariance_mm2, of.place.random_mm2)
    values = {f"{axis}_mm": value for axis, value in axes}
    if of.rate is not None:
        sigmas = zip("xy", of.rate.mm_per_day.tolist(), of.rate.sigma.tolist(), strict=True)
        values |= {f"d{axis}_mm_per_day": Value(rate, sigma) for axis, rate, sigma in sigmas}
    if of.displacement is not None:
        values["significance"] = Value(of.displacement.significance)
    return values


def _axes(mm: FloatArray, covariance_mm2: FloatArray, random_mm2: FloatArray) -> Iterator[tuple[str, Value]]:
    sigmas, randoms = np.sqrt(covariance_mm2.diagonal()), np.sqrt(random_mm2.diagonal())
    for axis, value, sigma, random in zip("xy", mm.tolist(), sigmas.tolist(), randoms.tolist(), strict=True):
        yield axis, Value(value, sigma, random)
