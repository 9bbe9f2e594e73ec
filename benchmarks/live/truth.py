"""How true measurements are: against the scene at their times, and in their own sigmas."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from hw_sim.unit import Unit

QUANTITIES = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")


@dataclass(frozen=True, slots=True)
class Truthfulness:
    """Rms of the errors against the scene's truth, and in units of the published sigma, by quantity."""

    rms: dict[str, float]
    rms_in_sigmas: dict[str, float]


def truthfulness(unit: Unit, measurements: Iterable[dict[str, Any]]) -> Truthfulness:
    """The errors of measurements against where the machine was, without its vibration, at their times."""
    errors: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    ratios: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    for one in measurements:
        truth = unit.truth(round(one["t_s"] * 1e9), vibration=False)
        for name in QUANTITIES:
            errors[name].append(one[name] - getattr(truth, name))
            ratios[name].append(errors[name][-1] / one["sigma"][name])
    return Truthfulness(
        {name: _rms(values) for name, values in errors.items()},
        {name: _rms(values) for name, values in ratios.items()},
    )


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value * value for value in values) / len(values)) if values else math.nan
