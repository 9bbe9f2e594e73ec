"""The last check before publishing: complete, finite and ordered numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from altd.reasons import Reason
from altd.records import Fault, Measurement, Quantity, Value


class Gate:
    """Lets measurements through; one that cannot be true loses its numbers and says ``check_failed``.

    It remembers the last valid one: a later measurement has a larger sequence and a later last exposure.
    After one that was out of order the order counts from there, or a single lie would stop all that follows.
    """

    def __init__(self) -> None:
        self._last: Measurement | None = None

    def admit(self, measurement: Measurement) -> Measurement:
        """The measurement itself, or without its numbers and with the reason."""
        if not measurement.valid and any(not fault.reason.is_warning for fault in measurement.status):
            return measurement
        before = self._last
        if measurement.valid:
            self._last = measurement
        doubt = next(_doubts(measurement, before), None)
        if doubt is None:
            return measurement
        warnings = tuple(fault for fault in measurement.status if fault.reason.is_warning)
        return measurement.without_numbers((Fault(Reason.CHECK_FAILED, detail=doubt), *warnings))


def _doubts(measurement: Measurement, before: Measurement | None) -> Iterator[str]:
    if not measurement.values:
        yield "no quantity is known"
    quantities = measurement.quantities
    yield from _doubts_of_values("", quantities.of_unit, measurement.values)
    for target, values in measurement.targets.items():
        yield from _doubts_of_values(f"{target}.", quantities.of_target, values or {})
    if measurement.frames < 1:
        yield f"it is the mean of {measurement.frames} exposures"
    if before is not None:
        if measurement.sequence <= before.sequence:
            yield f"sequence {measurement.sequence} does not follow {before.sequence}"
        if measurement.light_ns <= before.light_ns:
            yield f"exposed {(before.light_ns - measurement.light_ns) * 1e-9:g} s before the one before it"


def _doubts_of_values(
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
