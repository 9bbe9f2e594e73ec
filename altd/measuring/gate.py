"""Last check before publishing: complete, finite and ordered numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from altd.reasons import Reason
from altd.records import Fault, Measurement, Quantity, Value
from altd.records.joint import is_definite

_LATE_S = 10.0
"""Age at which every known part of the motion contributes to sigma, s."""
_ROUNDING = 1e-6
"""Relative difference of two figures of the same uncertainty that rounding explains."""


class Gate:
    """Admits measurements; removes the numbers of an impossible one, with the reason ``check_failed``.

    It remembers the last valid one: a later measurement has a larger sequence and a later last exposure.
    After one out of order the order counts from there; otherwise one wrong time would reject all later ones.
    """

    def __init__(self) -> None:
        self._last: Measurement | None = None

    def admit(self, measurement: Measurement) -> Measurement:
        """Return the measurement; if a check fails, without its numbers and with the reason."""
        if not measurement.valid and any(not fault.reason.is_warning for fault in measurement.status):
            return measurement
        before = self._last
        if measurement.valid:
            self._last = measurement
        violation = next(_violations(measurement, before), None)
        if violation is None:
            return measurement
        warnings = tuple(fault for fault in measurement.status if fault.reason.is_warning)
        return measurement.without_numbers((Fault(Reason.CHECK_FAILED, detail=violation), *warnings))


def _violations(measurement: Measurement, before: Measurement | None) -> Iterator[str]:
    if not measurement.values:
        yield "no quantity is known"
    quantities = measurement.quantities
    yield from _value_violations("", quantities.of_unit, measurement.values)
    for target, values in measurement.targets.items():
        yield from _value_violations(f"{target}.", quantities.of_target, values or {})
    yield from _joint_violations(measurement)
    yield from _motion_violations(measurement)
    if measurement.frames < 1:
        yield f"it is the mean of {measurement.frames} exposures"
    if before is not None:
        if measurement.sequence <= before.sequence:
            yield f"sequence {measurement.sequence} does not follow {before.sequence}"
        if measurement.light_ns <= before.light_ns:
            yield f"exposed {(before.light_ns - measurement.light_ns) * 1e-9:g} s before the one before it"


def _joint_violations(measurement: Measurement) -> Iterator[str]:
    if (joint := measurement.joint) is None:
        return
    variances = [(measurement.sigma(key) or math.nan) ** 2 for key in joint.keys]
    slack = [_ROUNDING * variance for variance in variances]
    for name, matrix in ("covariance", joint.covariance), ("scatter", joint.scatter):
        rows = matrix.tolist()
        if not math.isfinite(sum(map(sum, rows))):
            yield f"the joint {name} is not finite"
        elif not is_definite(rows, slack):  # as if both were divided by the variances
            yield f"the joint {name} has a negative eigenvalue"
    diagonal = zip(joint.covariance.diagonal().tolist(), variances, strict=True)
    if not all(abs(own - variance) < _ROUNDING * variance for own, variance in diagonal):
        yield "the joint covariance is not that of the sigmas"


def _motion_violations(measurement: Measurement) -> Iterator[str]:
    for key, rate in measurement.rates.items():
        if not math.isfinite(rate.value):
            yield f"the rate of {key} is {rate.value}"
        known = measurement.sigma_at(key, _LATE_S)
        if not all(math.isfinite(sigma) for sigma in (rate.sigma, known) if sigma is not None):
            yield f"how {key} moves is not known"


def _value_violations(
    prefix: str, quantities: tuple[Quantity, ...], values: Mapping[str, Value]
) -> Iterator[str]:
    for quantity in quantities:
        known = values.get(quantity.key)
        if known is None:
            if not quantity.is_optional:
                yield f"{prefix}{quantity.key} is not known"
            continue
        if not math.isfinite(known.value):
            yield f"{prefix}{quantity.key} is {known.value}"
        if quantity.has_sigma and known.sigma is None:
            yield f"{prefix}sigma_{quantity.key} is not known"
        elif known.sigma is not None and not (math.isfinite(known.sigma) and known.sigma > 0.0):
            yield f"{prefix}sigma_{quantity.key} is {known.sigma:g}"
        elif known.sigma_random is not None and not 0.0 < known.sigma_random <= (known.sigma or 0.0):
            yield f"{prefix}sigma_random of {quantity.key} is {known.sigma_random:g} of {known.sigma:g}"
